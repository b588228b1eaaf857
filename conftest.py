"""Kernels that look at all their arguments; the packages under examples/plugins, as if they were installed."""

import os
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

os.environ["PEPPER_DRIVER_CHECK_KERNELS"] = "1"

PLUGINS = Path(__file__).parent / "examples" / "plugins"


@pytest.fixture(scope="session")
def example_plugins(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Their modules on the path, and their entry points in metadata as an installer writes them."""
    site, before = tmp_path_factory.mktemp("site"), list(sys.path)
    for project in sorted(PLUGINS.glob("*/pyproject.toml")):
        about = tomllib.loads(project.read_text())["project"]
        info = site / f"{about['name'].replace('-', '_')}-{about['version']}.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Name: {about['name']}\nVersion: {about['version']}\n")
        lines = []
        for group, entries in about.get("entry-points", {}).items():
            lines += [f"[{group}]", *(f"{name} = {value}" for name, value in entries.items())]
        (info / "entry_points.txt").write_text("\n".join(lines))
        sys.path.append(str(project.parent))
    sys.path.append(str(site))
    yield
    sys.path[:] = before
