"""Signals end the program with 128 plus their number, also where a library swallows the exception they raise."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX systems")

PROGRAM = Path(sys.executable).with_name("meshdeform")
CODES = {signal.SIGINT: 130, signal.SIGTERM: 143, signal.SIGHUP: 129}

# A command that is interrupted in the middle of writing a file, by code that does with the exception what it likes.
SCRIPT = """\
import os, sys, time
from pathlib import Path
import click
from meshdeform_cli import main as entry
from meshdeform_formats.files import replacing

class Swallows:
    def __del__(self):
        print("ready", flush=True)
        time.sleep(5)

@click.command("info")
@click.argument("how")
def command(how):
    with replacing(Path("out.txt")) as partial:
        partial.write_text("half")
        if how == "destructor":
            Swallows()
        elif how == "llvm":
            from llvmlite import binding
            from llvmlite.binding import ffi
            free = ffi.lib.LLVMPY_DisposeString
            def freed(text):
                # An exception here makes the destructor of the string free it once more.
                free(text)
                print("ready", flush=True)
                time.sleep(0.3)
            ffi.lib._fntab["LLVMPY_DisposeString"] = freed
            binding.get_default_triple()
            time.sleep(5)
        elif how == "callback":
            try:
                print("ready", flush=True)
                time.sleep(5)
            except BaseException:
                raise RuntimeError("a library lost it")
        elif how == "bare":
            try:
                print("ready", flush=True)
                time.sleep(5)
            except:
                pass
        else:
            print("ready", flush=True)
            time.sleep(5)
    return 0

entry.LazyGroup.get_command = lambda self, context, name: command
entry.main(["info", sys.argv[1]])
"""


def heard() -> None:
    """Signals end the process also where those who run the tests, like nohup, have them ignored."""
    for number in CODES:
        signal.signal(number, signal.SIG_DFL)


def started(how: str, folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT, how], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        preexec_fn=heard,
    )  # fmt: skip


# Whatever becomes of the exception; signals differ in their numbers only.
@pytest.mark.parametrize(
    ("how", "number"),
    [
        *(("plainly", number) for number in CODES),
        *((how, signal.SIGINT) for how in ("destructor", "llvm", "callback", "bare")),
    ],
)
def test_exit_code_is_that_of_the_signal_and_nothing_is_left(how, number, tmp_path):
    with started(how, tmp_path) as process:
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        _, err = process.communicate(timeout=20)
    assert process.returncode == CODES[number], err
    assert "internal error" not in err
    assert "no output was left half-written" in err
    assert list(tmp_path.iterdir()) == []


def test_an_impatient_second_signal_does_not_disturb_the_cleaning_up(tmp_path):
    with started("plainly", tmp_path) as process:
        process.stdout.readline()
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            process.send_signal(number)
            time.sleep(0.002)
        process.communicate(timeout=20)
    # Of signals that arrive between two bytecodes Python handles those with smaller numbers first.
    assert process.returncode in (143, 130, 129)
    assert list(tmp_path.iterdir()) == []


def test_what_the_caller_ignores_stays_ignored(tmp_path):
    with subprocess.Popen(
        ["sh", "-c", 'trap "" HUP; exec "$0" -c "$1" bare', sys.executable, SCRIPT.replace("sleep(5)", "sleep(0.5)")],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        process.stdout.readline()
        process.send_signal(signal.SIGHUP)
        process.communicate(timeout=20)
    assert process.returncode == 0
    assert (tmp_path / "out.txt").read_text() == "half"


# Streams


def run_closed(redirection: str, *arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    words = " ".join(f"'{word}'" for word in (PROGRAM, *arguments))
    return subprocess.run(
        ["sh", "-c", f"{words} {redirection}"], cwd=cwd, capture_output=True, text=True, check=False, timeout=60
    )


@pytest.mark.parametrize(
    "redirection",
    [*(pytest.param(each, marks=pytest.mark.slow) for each in (">&-", "2>&-", "2>/dev/full")), "<&- >&- 2>&-"],
)
def test_closed_streams_change_nothing(redirection, bench):
    done = run_closed(redirection, "deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz", "-q", cwd=bench)
    assert done.returncode == 0, done.stderr
    assert "Traceback" not in done.stderr
    # An opened file must not have got the number of a closed stream.
    assert b"verdict" not in (bench / "out.xyz").read_bytes()


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize(
    ("redirection", "reason"), [(">/dev/full", "No space left on device"), (">&-", "Bad file descriptor")]
)
def test_output_that_cannot_be_written_is_an_error(redirection, reason, bench):
    done = run_closed(redirection, "info", "grid.xyz", cwd=bench)
    assert done.returncode == 2
    assert done.stderr == f"meshdeform: error: cannot write to stdout: {reason}\n"
