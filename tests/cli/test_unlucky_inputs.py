"""Inputs that ended with a traceback, took gigabytes or lost a file of the user: each is a message or simply works."""

from __future__ import annotations

import signal
import sys
import time
import zipfile
from types import SimpleNamespace

import numpy as np
import pytest

import meshdeform as md
from meshdeform_cli import looking, process
from meshdeform_core import interruption

RUN = ("deform", "grid.xyz", "-o", "out.xyz")


@pytest.mark.parametrize("depth", [40, 100_000])
def test_deep_keys_of_a_case_are_refused_at_once(depth, bench, call):
    (bench / "deep.toml").write_text(".".join(["a"] * depth) + " = 1\n")
    start = time.process_time()
    result = call(*RUN, "-c", "deep.toml")
    assert result.code == 2
    assert "has more than 30 parts" in result.err
    assert time.process_time() - start < 5.0


def test_long_words_and_paths_of_a_case_are_no_deep_keys(bench, call):
    text = (bench / "case.toml").read_text()
    (bench / "long.toml").write_text("# " + "/".join(["a.b"] * 50) + "\n# " + "word" * 50_000 + "\n" + text)
    assert call(*RUN, "-c", "long.toml", "-q").code == 0


def test_a_table_that_declares_gigabytes_of_zeros_is_refused_before_it_is_unpacked(tmp_path, bench, call):
    header = np.lib.format
    with zipfile.ZipFile(bench / "zeros.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        for name in ("points", "displacement"):
            with archive.open(f"{name}.npy", "w") as member:
                count = 1 << 23
                header.write_array_header_1_0(member, {"descr": "<f8", "fortran_order": False, "shape": (count, 3)})
                for _ in range(24):
                    member.write(bytes(count))
    result = call(*RUN, "-d", "zeros.npz")
    assert result.code == 2
    assert "which no table of displacements does" in result.err


@pytest.mark.parametrize("name", ["a[1]", "a\nb*"])
def test_init_writes_patterns_that_select_its_own_faces(name, tmp_path, call, monkeypatch):
    monkeypatch.chdir(tmp_path)
    block = np.stack(np.meshgrid(*[np.linspace(0.0, 1.0, 4)] * 3, indexing="ij"), axis=-1)
    md.write(md.Grid([block], names=[name]), "nm.vtm")
    assert call("init", "nm.vtm", "-o", "nm.toml").code == 0
    result = call("deform", "nm.vtm", "-c", "nm.toml", "--dry-run", "-q")
    # Its faces are found; none of them is a wall, so that nothing moves yet.
    assert (result.code, "no node moves" in result.err) == (2, True), result.err


def test_a_signal_within_a_callback_of_the_collector_prints_no_traceback(monkeypatch, capsys):
    """Python cannot deliver the exception there; the next check ends the program."""
    monkeypatch.setattr(interruption, "_requests", [signal.SIGINT])
    monkeypatch.setattr(sys, "unraisablehook", sys.unraisablehook)
    lost = SimpleNamespace(
        exc_type=SystemExit, exc_value=SystemExit(130), exc_traceback=None, err_msg=None, object=None
    )
    process._unraisable(lost)
    assert capsys.readouterr().err == ""
    with pytest.raises(SystemExit):
        interruption.check()


def test_a_file_that_ends_too_early_for_a_library_is_no_interrupt(call, bench, monkeypatch):
    """click turns EOFError into what Ctrl-C raises."""

    def broken(**_: object) -> None:
        raise EOFError("marshal data too short")

    monkeypatch.setattr(looking.info_command, "callback", broken)
    result = call("info", "grid.xyz")
    assert result.code == 1
    assert "marshal data too short" in result.err
    assert "interrupted" not in result.err
