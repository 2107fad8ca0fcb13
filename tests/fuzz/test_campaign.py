"""The campaign itself: what it takes for right and what for wrong."""

from __future__ import annotations

import contextlib
import signal
import time
from pathlib import Path
from unittest import mock

import pytest
from grids import CASE, frame

from fuzz.bench import called, refusal
from fuzz.campaign import limited, table
from meshdeform_formats import write_grid

pytestmark = pytest.mark.skipif(not hasattr(signal, "SIGPROF"), reason="clocks of POSIX systems")


def wait(*_, **__):
    while True:
        time.sleep(0.01)


def work(*_, **__):
    while True:
        sum(range(1000))


def swallow(*_, **__):
    """A hang in code that takes every exception once."""
    with contextlib.suppress(BaseException):
        work()
    work()


@pytest.mark.parametrize(("hang", "place"), [
    (wait, "meshdeform_formats.grids.read_grid"), (work, "meshdeform_cli.work.write_grid"),
    (swallow, "meshdeform_cli.work.write_grid"),
])  # fmt: skip
def test_a_hang_is_wrong_and_never_refused(hang, place, tmp_path, monkeypatch):
    """Wherever the program hangs: while it reads, or where it takes errors of the system for a full disk."""
    monkeypatch.chdir(tmp_path)
    write_grid(frame(1, 1), "grid.xyz")
    Path("case.toml").write_text(CASE)

    def sample(number: int) -> tuple[str, str]:
        code, told = called("deform", "grid.xyz", "-c", "case.toml", "-m", "tfi", "-o", "out.xyz", "-q", "--force")
        return "hang", "ok" if code == 0 else refusal(code, told)

    assert limited(sample, 0)[1] == "ok"
    with mock.patch(place, hang):
        _, result = limited(sample, 0, 0.05)
    assert result.startswith("TooLong"), result
    assert signal.getitimer(signal.ITIMER_PROF) == (0.0, 0.0)
    assert "| judge | 1 | 0 | 0 | 1 |" in table([(0, "judge", result)], 1)
    assert limited(sample, 0)[1] == "ok"
