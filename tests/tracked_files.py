"""What git tracks: no binary file that is not listed here, nothing large, no path of somebody's home folder.

python tests/tracked_files.py [FOLDER]      exit code 1 and one line per file where something is wrong
"""

import re
import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path

BINARY = ("docs/images/*.png", "studies/*.png")
"""Binary files that belong here."""
LARGEST = 300_000
"""Bytes of a file."""
_HOME = re.compile(rb"(?:/(?:home|Users)/|[A-Za-z]:\\+Users\\+)[\w.-]+|/root/\w")


def complaints(folder: Path) -> list[str]:
    """One line for every tracked file that should not be tracked as it is."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=folder, capture_output=True, check=True).stdout
    names = [name.decode() for name in listed.split(b"\0") if name]
    # What is deleted but not yet committed is not there.
    found = ((name, folder / name) for name in names if (folder / name).is_file())
    return [f"{name}: {wrong}" for name, file in found for wrong in _wrong(name, file.read_bytes())]


def _wrong(name: str, content: bytes) -> list[str]:
    told = []
    if len(content) > LARGEST:
        told.append(f"{len(content):,} bytes; at most {LARGEST:,}")
    if _is_binary(content) and not any(fnmatch(name, pattern) for pattern in BINARY):
        told.append("binary; if it has to be here, list it in tests/tracked_files.py")
    if home := _HOME.search(content):
        told.append(f"holds the path of a home folder, {home[0].decode()}...")
    return told


def _is_binary(content: bytes) -> bool:
    try:
        return "\0" in content.decode()
    except UnicodeDecodeError:
        return True


def main(folder: Path) -> int:
    """The exit code; a folder that git does not keep, like an unpacked source distribution, has nothing to check."""
    if not (folder / ".git").exists():
        print(f"{folder} is not kept by git: tracked files are not checked")
        return 0
    told = complaints(folder)
    print("\n".join(told) or "tracked files: nothing binary, large or with a path of a home folder")
    return int(bool(told))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).parents[1]))
