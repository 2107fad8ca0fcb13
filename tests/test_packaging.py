"""The distribution: every package in it, and a program that runs from what `pip install .` puts into an environment."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]


def test_every_package_on_disk_is_listed():
    """Setuptools builds a wheel without a package that is missing from the list, and says nothing."""
    setup = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
    folders = {Path(folder): name for name, folder in setup["package-dir"].items()}
    found = set()
    for top, name in folders.items():
        for file in (ROOT / top).rglob("__init__.py"):
            inside = file.parent.relative_to(ROOT / top).parts
            found.add(".".join((name, *inside)))
    assert found == set(setup["packages"])


def test_the_version_is_stated_alike():
    """pyproject.toml, citation, manual page, and the newest release of the changelog."""
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert f'"meshdeform {version}"' in (ROOT / "docs/man/meshdeform.1").read_text().splitlines()[0]
    released = [line for line in (ROOT / "CHANGELOG.md").read_text().splitlines() if line.startswith("## ")][1]
    assert released.startswith(f"## {version} (")


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Scripts of a fresh environment with the program installed as `pip install .` does, dependencies borrowed."""
    folder = tmp_path_factory.mktemp("installed")
    # A copy: building in place leaves files behind that the next wheel would hold.
    source = folder / "source"
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(".*", "build", "dist", "demo", "tests", "*.egg-info"))
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet")
    built = run(*pip, "wheel", "--no-deps", "--wheel-dir", folder, source, timeout=120)
    if built.returncode and ("No matching distribution" in built.stderr or "ConnectionError" in built.stderr):
        pytest.skip("no network: setuptools is not at hand")
    assert built.returncode == 0, built.stderr
    (wheel,) = folder.glob("*.whl")
    venv.create(folder / "env", with_pip=False, symlinks=True)
    bin = folder / "env" / ("Scripts" if sys.platform == "win32" else "bin")
    done = run(*pip, "--python", bin / "python", "install", "--no-deps", "--no-index", wheel, timeout=60)
    assert done.returncode == 0, done.stderr
    where = run(bin / "python", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))")
    # A path in a .pth file is searched, but the .pth files in it (an editable install) are not obeyed.
    (Path(where.stdout.strip()) / "borrowed.pth").write_text(f"{Path(np.__file__).parents[1]}\n")
    return bin


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
    # The kernels are compiled at the first use of an installation.
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
@pytest.mark.timeout(300)
def test_installed_library_runs_a_coupled_solver(installed, tmp_path):
    script = ROOT / "examples" / "coupling.py"
    done = run(installed / "python", script, tmp_path, cwd=tmp_path, timeout=240)
    assert done.returncode == 0, done.stderr
    assert done.stderr.count("Step(valid") == 3
    assert (tmp_path / "bent.cgns").is_file()
