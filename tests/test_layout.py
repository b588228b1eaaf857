"""The house: layers, packaging, nothing that ties the repository to one machine."""

import ast
import subprocess
import tomllib
from importlib.resources import files
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
LAYERS = ("config", "backends", "controller", "observer", "pepper_driver")
LINKED = LAYERS[:-1]


def sources(layer: str) -> list[Path]:
    return [
        p for p in sorted((ROOT / layer).rglob("*.py")) if layer != "pepper_driver" or not linked(p)
    ]


def linked(path: Path) -> bool:
    return any((ROOT / "pepper_driver" / name) in path.parents for name in LINKED)


def imported_layers(path: Path) -> set[str]:
    """Layers that a file imports from; ``pepper_driver.x`` with x no lower layer counts as pepper_driver."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        for name in names:
            parts = name.split(".")
            if parts[0] == "pepper_driver":
                found.add(parts[1] if len(parts) > 1 and parts[1] in LINKED else "pepper_driver")
    return found


@pytest.mark.parametrize("layer", LAYERS)
def test_layers_import_only_downwards(layer: str) -> None:
    allowed = set(LAYERS[: LAYERS.index(layer) + 1])
    assert sources(layer), f"no sources found for {layer}"
    for path in sources(layer):
        above = imported_layers(path) - allowed
        assert not above, f"{path.relative_to(ROOT)} imports from {above}, which lies above {layer}"


def test_the_layer_rule_sees_an_upward_import(tmp_path: Path) -> None:
    file = tmp_path / "bad.py"
    file.write_text("from pepper_driver.observer import Contact\nimport pepper_driver.robot\n")
    assert imported_layers(file) == {"observer", "pepper_driver"}


def test_what_judges_does_not_need_what_fits_plants() -> None:
    for path in (ROOT / "pepper_driver" / "evaluation").rglob("*.py"):
        assert "pepper_driver.calibration" not in path.read_text(), path.relative_to(ROOT)


@pytest.mark.parametrize("layer", LAYERS)
def test_nothing_private_is_imported_from_another_file(layer: str) -> None:
    for path in sources(layer):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom):
                private = [alias.name for alias in node.names if alias.name.startswith("_")]
                assert not private, f"{path.relative_to(ROOT)} imports {private}"
                assert node.level == 0, f"{path.relative_to(ROOT)} imports relatively"


@pytest.mark.parametrize("name", LINKED)
def test_links_point_to_the_folders(name: str) -> None:
    link = ROOT / "pepper_driver" / name
    if not link.is_symlink():
        pytest.skip("a checkout without links still works; type checkers then miss the layers")
    assert link.readlink() == Path("..") / name
    assert (ROOT / name).is_dir()
    assert not (ROOT / name).is_symlink()


def test_pyproject_lists_every_package() -> None:
    setup = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    expected = set()
    for layer in LAYERS:
        for init in (ROOT / layer).rglob("__init__.py"):
            if layer == "pepper_driver" and linked(init):
                continue
            parts = init.parent.relative_to(ROOT).parts
            expected.add(".".join(parts if layer == "pepper_driver" else ("pepper_driver", *parts)))
    assert set(setup["packages"]) == expected | {"pepper_driver.examples"}


def test_every_folder_with_sources_is_a_package() -> None:
    for layer in LAYERS:
        for path in sources(layer):
            assert (path.parent / "__init__.py").exists(), path


@pytest.mark.parametrize(
    "name", ["pepper.urdf", "pepper.yaml", "plants/nominal.yaml", "experiments/demo.yaml"]
)
def test_data_files_are_found_in_the_package(name: str) -> None:
    assert files("pepper_driver.config").joinpath(name).is_file()


def test_no_pickle_and_no_path_of_a_machine() -> None:
    listed = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if listed.returncode != 0:
        pytest.skip("not a git checkout")
    here = Path(__file__).name
    for name in listed.stdout.split():
        path = ROOT / name
        if path.suffix not in {".py", ".md", ".yaml", ".toml", ".urdf", ".json"}:
            continue
        if path.name == here or not path.is_file():
            continue
        text = path.read_text()
        words = ["/home/", "/root/", "/work/"]
        if not name.startswith("tests/"):  # tests hand pickles to loaders that must refuse them
            words += ["import pickle", "allow_pickle=True"]
        for word in words:
            assert word not in text, f"{name} holds '{word}'"


NO_BEGIN = ("What", "Who", "How", "Whether", "When", "Where", "Which", "Of", "Those", "Likewise")
"""First words of docstrings that are neither imperatives nor noun phrases."""


@pytest.mark.parametrize("folder", [*LAYERS, "benchmarks", "examples", "tests"])
def test_docstrings_are_imperatives_or_noun_phrases(folder: str) -> None:
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    files = sources(folder)
    assert files, f"no sources found for {folder}"
    for path in files:
        for node in ast.walk(ast.parse(path.read_text())):
            first = ((isinstance(node, documented) and ast.get_docstring(node)) or "").split(" ")[0]
            where = f"{path.relative_to(ROOT)}: {getattr(node, 'name', 'module')}"
            assert first.rstrip(",.:") not in NO_BEGIN, f"{where} begins with {first}"
