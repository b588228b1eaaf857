"""State that can be saved and put back, so that a simulation goes on bit by bit as it would have."""

from __future__ import annotations

import copy
from typing import Any, ClassVar


class Resumable:
    """Something whose state is the attributes named in ``STATE``; everything else follows from its construction."""

    STATE: ClassVar[tuple[str, ...]] = ()

    def save(self) -> dict[str, Any]:
        """A copy of the state."""
        return {name: copy.deepcopy(getattr(self, name)) for name in self.STATE}

    def restore(self, saved: dict[str, Any]) -> None:
        """Take on a state that :meth:`save` gave."""
        for name in self.STATE:
            setattr(self, name, copy.deepcopy(saved[name]))
