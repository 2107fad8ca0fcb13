"""Fixtures for all tests: where the third-party grids lie, and a clean place to write."""

import gc
import os
from pathlib import Path

# Threads of linear algebra libraries that wait in busy loops slow down all other workers of the test run.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

import hypothesis  # noqa: E402 (numpy reads the variables when it is loaded)
import pytest  # noqa: E402

# The same examples in every run, and no limits of time: a loaded machine is no reason to fail.
hypothesis.settings.register_profile(
    "repeatable", derandomize=True, deadline=None, suppress_health_check=[hypothesis.HealthCheck.too_slow]
)
hypothesis.settings.load_profile("repeatable")


@pytest.fixture(scope="session", autouse=True)
def _small_pictures() -> None:
    """Commands called in this process draw a tenth of the pixels; what is drawn and where stays the same."""
    from meshdeform_formats.picture.page import STYLE

    STYLE["figure.dpi"] = 60


def pytest_collection_finish() -> None:
    """The collector leaves alone what is imported, which stays: looking through it takes a twentieth of the time. It
    looks at the rest seldom, for another fiftieth."""
    gc.freeze()
    gc.set_threshold(20_000, 20, 100)


@pytest.fixture
def own_garbage() -> None:
    """``gc.collect()`` searches what the test itself makes, not all that is imported: a hundred times faster."""
    gc.freeze()


@pytest.fixture
def openmdao_folder(monkeypatch, tmp_path) -> None:
    """OpenMDAO makes folders where it runs."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("OPENMDAO_REPORTS", "0")


@pytest.fixture(scope="session")
def third_party() -> Path:
    """Folder of third-party grids with oracle coordinates; they may not be committed, so they may be absent."""
    folder = Path(os.environ.get("MESHDEFORM_GRIDS", Path(__file__).parents[2] / "shared" / "grids"))
    if not (folder / "oracle" / "summary.json").is_file():
        pytest.skip(f"third-party grids are not at {folder} (set MESHDEFORM_GRIDS)")
    return folder
