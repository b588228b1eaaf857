"""Touches that a person is asked for, one after the other, while a run is recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from pepper_driver.config.errors import ConfigError, UnknownNameError, suggestion
from pepper_driver.config.lines import with_lines
from pepper_driver.config.loading import STRICT, load, package_file
from pepper_driver.config.parts import Positive
from pepper_driver.config.robot import RobotConfig
from pepper_driver.config.steps import Speech

MAX_TOUCHES = 200

SHIPPED = {"standard": "touch_prompts.yaml", "scale": "touch_prompts_scale.yaml"}
"""Files of the shipped prompts by their names: by hand alone, and half of them with a spring scale."""


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TouchPrompt:
    """One touch.

    Attributes:
        say: Words for the person who touches, spoken and printed.
        link: To be touched.
        force: Of a touch with a spring scale [N]; None where no one measures it.
    """

    say: Speech
    link: str
    force: Positive | None = None


@dataclass(frozen=True, kw_only=True, config=STRICT)
class TouchPrompts:
    """Content of ``touch_prompts.yaml``.

    Attributes:
        version: Of its format.
        rest: Time without a touch at begin and end [s].
        time: For each touch [s].
        touches: In their order.
    """

    version: Literal[1]
    rest: Annotated[float, Field(ge=0.0, le=600.0)]
    time: Annotated[float, Field(ge=2.0, le=600.0)]
    touches: Annotated[tuple[TouchPrompt, ...], Field(min_length=1, max_length=MAX_TOUCHES)]

    @property
    def seconds(self) -> float:
        """Length of the whole [s]."""
        return 2.0 * self.rest + self.time * len(self.touches)

    def __str__(self) -> str:
        return f"{len(self.touches)} touches in {self.seconds:g} s"


@with_lines
def load_touch_prompts(robot: RobotConfig, name: Path | str = "standard") -> TouchPrompts:
    """Load the prompts of a name in SHIPPED, or those of a file.

    Raises:
        UnknownNameError: No shipped prompts have this name.
        ConfigError: The file is wrong, or names a link that the robot has not.
    """
    if str(name) in SHIPPED:
        file = package_file(SHIPPED[str(name)])
    elif str(name).endswith((".yaml", ".yml")):
        file = Path(name)
    else:
        raise UnknownNameError("prompts", str(name), (*SHIPPED, "FILE.yaml"))
    prompts = load(TouchPrompts, file)
    for number, touch in enumerate(prompts.touches):
        if touch.link not in robot.links:
            raise ConfigError(
                f"{file}: key 'touches.{number}.link': unknown link '{touch.link}'"
                f"{suggestion(touch.link, robot.links)}"
            )
    return prompts
