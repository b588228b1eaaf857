"""What a log says of the run it belongs to."""

from __future__ import annotations

import platform
from importlib.metadata import version

from pepper_driver.backends import BackendInfo
from pepper_driver.observer import Observer


def run_metadata(info: BackendInfo, observer: Observer | None) -> dict[str, str]:
    """Robot, observer and versions, as text; no name of a person or a machine."""
    return {
        "pepper_driver": version("pepper-driver"),
        "backend": info.uri,
        "identity": info.identity,
        "observer": observer.describe() if observer is not None else "none",
        "response_delay": str(info.response_delay),
        "python": platform.python_version(),
        "numpy": version("numpy"),
        "mujoco": version("mujoco"),
        "machine": f"{platform.system()} {platform.machine()}",
    }
