"""ALMotion, autonomous life and the touch reactions move the joints too: stilled before we do, and given back after."""

from __future__ import annotations

from types import TracebackType
from typing import Self

from pepper_driver.backends.naoqi.connection import Connection


class TakeOver:
    """Stills what else moves the robot, on entering; gives all back in reverse order, on leaving.

    Leaving never raises: what could not be given back is in ``left`` and is told by ``logging``.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self.left: tuple[str, ...] = ()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.restore()

    def restore(self) -> None:
        """Give all back, each whether or not another fails. Does nothing the second time."""
