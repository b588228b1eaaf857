"""A wheel and an sdist hold every layer once, and what is installed from them works."""

import os
import shutil
import subprocess
import sys
import tarfile
import zipfile
from pathlib import Path

import pytest

from support import ROOT

LAYERS = ("config", "backends", "controller", "observer")


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Wheel, built from the sdist as pip would, and sdist, of a clean copy of what git knows."""
    folder = tmp_path_factory.mktemp("build")
    copy = folder / "copy"
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard", "-z"],
        cwd=ROOT,
        capture_output=True,
        check=False,
    )
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    for name in filter(None, listed.stdout.decode().split("\0")):
        source, target = ROOT / name, copy / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_symlink():
            target.symlink_to(source.readlink())
        elif source.is_file():
            target.write_bytes(source.read_bytes())
    subprocess.run(
        [
            sys.executable,
            "-m",
            "build",
            "--no-isolation",
            "--outdir",
            str(folder / "dist"),
            str(copy),
        ],
        check=True,
        capture_output=True,
    )
    dist = folder / "dist"
    return next(dist.glob("*.whl")), next(dist.glob("*.tar.gz"))


@pytest.mark.whole
def test_the_wheel_holds_every_file_once(built: tuple[Path, Path]) -> None:
    names = zipfile.ZipFile(built[0]).namelist()
    assert len(names) == len(set(names))
    top = {name.split("/")[0] for name in names}
    assert top == {"pepper_driver", next(n for n in top if n.endswith(".dist-info"))}
    for layer in LAYERS:
        expected = {
            str(p.relative_to(ROOT))
            for pattern in ("*.py", "*.yaml", "*.urdf", "*.json")
            for p in (ROOT / layer).rglob(pattern)
        }
        found = {n.removeprefix("pepper_driver/") for n in names}
        assert expected <= found
    assert "pepper_driver/py.typed" in names


@pytest.mark.whole
def test_the_sdist_keeps_the_folders_of_the_house(built: tuple[Path, Path]) -> None:
    with tarfile.open(built[1]) as archive:
        names = [n.partition("/")[2] for n in archive.getnames()]
    for layer in LAYERS:
        assert f"{layer}/__init__.py" in names
        assert f"pepper_driver/{layer}/__init__.py" not in names


@pytest.mark.whole
def test_the_installed_wheel_works(built: tuple[Path, Path], tmp_path: Path) -> None:
    subprocess.run(
        [
            sys.executable,
            "-m",
            "pip",
            "install",
            "--quiet",
            "--no-deps",
            "--target",
            str(tmp_path),
            str(built[0]),
        ],
        check=True,
        capture_output=True,
    )
    script = (
        "import pepper_driver, pathlib\n"
        "import pepper_driver.testing.conformance\n"
        f"assert pathlib.Path(pepper_driver.__file__).is_relative_to({str(tmp_path)!r})\n"
        "with pepper_driver.Pepper('mujoco://?plant=integral') as pepper:\n"
        "    pepper.push('LBicep', [0, 25, 0], [0.16, 0, 0], 0.8, frame='link')\n"
        "    pepper.run(1.5)\n"
        "print(len(pepper.contact_history))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={"PYTHONPATH": str(tmp_path), "PATH": ""},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
    )
    assert int(done.stdout) >= 2
    subprocess.run(
        [sys.executable, "-m", "pepper_driver", "examples", "mine"],
        env={"PYTHONPATH": str(tmp_path), "PATH": ""},
        cwd=tmp_path,
        capture_output=True,
        check=True,
    )
    listed = subprocess.run(
        ["git", "ls-files", "-z", "examples"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    for name in filter(None, listed.stdout.split("\0")):
        copied = tmp_path / "mine" / Path(name).relative_to("examples")
        assert copied.read_bytes() == (ROOT / name).read_bytes()


@pytest.mark.whole
def test_the_plug_in_packages_install_and_are_found(tmp_path: Path) -> None:
    source, target = tmp_path / "plugins", tmp_path / "site"
    shutil.copytree(ROOT / "examples" / "plugins", source)  # a build leaves files behind
    packages = sorted(str(project.parent) for project in source.glob("*/pyproject.toml"))
    assert len(packages) == 5
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--target", str(target)]
    subprocess.run(
        [sys.executable, "-m", "pip", "install", *options, *packages],
        check=True,
        capture_output=True,
    )
    script = (
        "from pepper_driver import Pepper\n"
        "from pepper_driver.config import load_robot\n"
        "from pepper_driver.reflexes.declared import make_reflex\n"
        "from ceiling import Ceiling\n"
        "from hands_apart import HandsApart\n"
        "reflex = make_reflex({'do': 'lift_arm'}, load_robot(), 'a.yaml', 'reflexes.0')\n"
        "with Pepper('pinocchio://?seed=3', observer='resting', reflexes=[reflex]) as pepper:\n"
        "    pepper.add(HandsApart(0.5))\n"
        "    pepper.add(Ceiling('Head', 1.5))\n"
        "    pepper.run(0.5)\n"
        "    print(pepper.observer.describe())\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script],
        env={"PYTHONPATH": f"{target}{os.pathsep}{ROOT}", "PATH": ""},
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("resting")
