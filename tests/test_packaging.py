"""The distribution: every package in it, and a program that runs from what `pip install .` puts into an environment."""

import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import venv
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
DECLARED = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT, SETUP = DECLARED["project"], DECLARED["tool"]["setuptools"]
NEEDED = PROJECT["dependencies"]


def test_every_package_on_disk_is_listed():
    """Setuptools builds a wheel without a package that is missing from the list, and says nothing."""
    folders = {Path(folder): name for name, folder in SETUP["package-dir"].items()}
    found = set()
    for top, name in folders.items():
        for file in (ROOT / top).rglob("__init__.py"):
            inside = file.parent.relative_to(ROOT / top).parts
            found.add(".".join((name, *inside)))
    assert found == set(SETUP["packages"])


def test_the_version_is_stated_alike():
    """pyproject.toml, citation, manual page, and the newest release of the changelog."""
    version = PROJECT["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert f'"meshdeform {version}"' in (ROOT / "docs/man/meshdeform.1").read_text().splitlines()[0]
    released = next(line for line in (ROOT / "CHANGELOG.md").read_text().splitlines() if line.startswith("## "))
    assert released.startswith(f"## {version} (")
    assert f'version: "{version}"' in (ROOT / "packaging/conda/recipe.yaml").read_text()


def test_the_conda_recipe_requires_what_the_package_does():
    """conda calls matplotlib without its windows matplotlib-base, and separates name and version by a blank."""
    recipe = (ROOT / "packaging/conda/recipe.yaml").read_text()
    required = re.findall(r"^    - ([\w-]+) (>=\S+)$", recipe.partition("  run:\n")[2].partition("tests:")[0], re.M)
    declared = [re.match(r"([\w-]+)(.*)", each).groups() for each in (f"python{PROJECT['requires-python']}", *NEEDED)]
    assert [(name.removesuffix("-base"), version) for name, version in required] == declared


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel that is built from the source distribution, in a folder that has both."""
    folder = tmp_path_factory.mktemp("built")
    # A copy: building in place leaves files behind that the next wheel would hold.
    source = folder / "source"
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(".*", "build", "dist", "demo", "*.egg-info"))
    built = run(sys.executable, "-m", "build", "--outdir", folder, source, timeout=240)
    if built.returncode and ("No matching distribution" in built.stdout or "ConnectionError" in built.stdout):
        pytest.skip("no network: setuptools is not at hand")
    assert built.returncode == 0, built.stdout + built.stderr
    (found,) = folder.glob("*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel: Path) -> Path:
    """Scripts of a fresh environment with the program installed as `pip install .` does, dependencies borrowed, and the
    loops that are compiled here: that an installation compiles its own is seen at the lowest versions."""
    folder = environment(wheel.parent / "env")
    install(folder, "--no-deps", "--no-index", wheel)
    where = run(folder / "python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))")
    packages = Path(where.stdout.strip())
    # A path in a .pth file is searched, but the .pth files in it (an editable install) are not obeyed.
    (packages / "borrowed.pth").write_text(f"{Path(np.__file__).parents[1]}\n")
    for name, top in SETUP["package-dir"].items():
        for loop in (ROOT / top).rglob("*.nb[ci]"):
            place = packages / name / loop.relative_to(ROOT / top)
            if place.parents[1].is_dir():
                place.parent.mkdir(exist_ok=True)
                shutil.copy(loop, place)
    return folder


def environment(folder: Path) -> Path:
    """The folder of the programs of a fresh environment."""
    venv.create(folder, with_pip=False, symlinks=True)
    return folder / ("Scripts" if sys.platform == "win32" else "bin")


def install(programs: Path, *what: object) -> None:
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")
    done = run(*pip, "--python", programs / "python", "install", *what, timeout=240)
    if "No matching distribution" in done.stderr and "--no-index" not in what:
        pytest.skip("no network, or a release that is not kept for this Python")
    assert done.returncode == 0, done.stderr


def run(*command: object, cwd: Path | None = None, timeout: float = 30) -> subprocess.CompletedProcess[str]:
    return subprocess.run([str(c) for c in command], capture_output=True, text=True, cwd=cwd, timeout=timeout)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_installed_program_runs_in_another_folder(installed, tmp_path):
    program = installed / "meshdeform"
    where = run(installed / "python", "-c", "import meshdeform_cli; print(meshdeform_cli.__file__)", cwd=tmp_path)
    assert where.stdout.startswith(str(installed.parent))
    sample = run(program, "sample", "splitter-plate", "-o", "case", cwd=tmp_path)
    assert (sample.returncode, sample.stderr) == (0, "")
    for name in ("grid.cgns", "case.toml", "README.md"):
        assert (tmp_path / "case" / name).is_file()
    done = run(
        program, "deform", "case/grid.cgns", "-c", "case/case.toml", "-o", "case/deformed.cgns", "--report", "r.json",
        cwd=tmp_path, timeout=240,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "verdict   valid" in done.stdout
    assert (tmp_path / "case" / "deformed.cgns").is_file()
    as_module = run(installed / "python", "-m", "meshdeform_cli", "--version", cwd=tmp_path)
    assert as_module.returncode == 0
    assert as_module.stdout.startswith("meshdeform")


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.skipif(sys.version_info[:2] != (3, 11), reason="the lowest versions are those of the lowest Python")
def test_the_lowest_versions_that_are_declared_are_enough(wheel, tmp_path):
    programs = environment(tmp_path / "env")
    install(programs, wheel, *(each.partition(",")[0].replace(">=", "==") for each in NEEDED))
    program = programs / "meshdeform"
    assert run(program, "sample", "splitter-plate", "-o", "case", cwd=tmp_path).returncode == 0
    done = run(
        program, "deform", "case/grid.cgns", "-c", "case/case.toml", "-o", "case/deformed.cgns", "--report", "r.html",
        cwd=tmp_path, timeout=300,
    )  # fmt: skip
    assert (done.returncode, done.stderr.count("Traceback")) == (0, 0), done.stderr
    drawn = run(program, "plot", "case/deformed.cgns", "-o", "drawn.pdf", "--plane", "k=1", cwd=tmp_path, timeout=120)
    assert drawn.returncode == 0, drawn.stderr


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_source_distribution_holds_what_its_tests_read(wheel):
    (archive,) = wheel.parent.glob("*.tar.gz")
    with tarfile.open(archive) as source:
        names = {name.partition("/")[2] for name in source.getnames()}
    kept = run("git", "ls-files", cwd=ROOT)
    if kept.returncode:
        pytest.skip("not a clone")
    missing = {name for name in kept.stdout.splitlines() if not name.startswith((".", "packaging/conda/."))} - names
    assert not missing
