"""The check of what git tracks finds what it is for."""

import shutil
import subprocess

import pytest
import tracked_files

pytestmark = pytest.mark.skipif(shutil.which("git") is None, reason="git is not installed")
HOME = "/ho" + "me/"


@pytest.fixture
def repository(tmp_path):
    """``repository(name, content)``: what is wrong with a folder in which this file, and a good one, are tracked."""
    subprocess.run(["git", "init", "-q", tmp_path], check=True)

    def complaints(name: str, content: bytes) -> list[str]:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(content)
        (tmp_path / "good.py").write_text("α = 1\n")
        subprocess.run(["git", "add", "."], cwd=tmp_path, check=True)
        told = tracked_files.complaints(tmp_path)
        assert tracked_files.main(tmp_path) == bool(told)
        return told

    return complaints


@pytest.mark.parametrize(
    ("name", "content", "wrong"),
    [
        ("loop.nbi", b"\x80\x04\x95", "binary"),
        ("zeros", b"text\0", "binary"),
        ("docs/images/grid.cgns", b"\x89HDF\0", "binary"),
        ("table.csv", b"0,0\n" * 75_001, "300,004 bytes"),
        ("notes.md", f"in {HOME}somebody/grids\n".encode(), f"home folder, {HOME}somebody"),
        ("notes.md", b"in C:\\Us" + rb"ers\somebody", "home folder"),
        ("docs/images/picture.png", b"\x89PNG\0" + f"{HOME}somebody".encode(), "home folder"),
    ],
)
def test_what_should_not_be_tracked_is_found(repository, name, content, wrong):
    (told,) = repository(name, content)
    assert told.startswith(f"{name}: ")
    assert wrong in told


@pytest.mark.parametrize("name", ["empty", "docs/images/a.png", "docs/images/pages/a.png"])
def test_pictures_and_text_may_be_tracked(repository, name):
    assert repository(name, b"\x89PNG\0" if name.endswith("png") else b"") == []


def test_files_that_are_ignored_do_not_count(repository, tmp_path):
    (tmp_path / ".gitignore").write_text("build/\n")
    assert repository("build/loop.nbi", b"\x80") == []


def test_a_folder_without_git_has_nothing_to_check(tmp_path, capsys):
    (tmp_path / "loop.nbi").write_bytes(b"\x80")
    assert tracked_files.main(tmp_path) == 0
    assert "not kept by git" in capsys.readouterr().out
