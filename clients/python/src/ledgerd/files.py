"""The files of contexts: locked, read, and replaced as a whole.

The same places, permissions and locks as `ledgerctl` has, so that both work on one home at the same time. A context is
written as a new directory `.NAME.new` and synced; the old one steps aside as `.NAME.old`. After a crash between the two
steps, `finish_replacement` of either program brings the old one back.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import stat
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final

from ledgerd.refusal import Refusal, refusal

SETTINGS: Final = "context.toml"
CERTIFICATE: Final = "certificate.pem"
KEY: Final = "key.pem"
MSPS: Final = "msps.json"
NODES: Final = "nodes.json"
CONTEXTS: Final = "contexts"
CURRENT: Final = "current"

_LOCK: Final = ".lock"
_FILE_BYTES_MAX: Final = 4 * 1024 * 1024
_SECRET_MODE: Final = 0o600
_DIRECTORY_MODE: Final = 0o700
_OTHERS: Final = 0o077
# How long a reader waits for a writer, a writer for others, and one who only notes what it has learnt; seconds.
_READER_WAITS_MAX: Final = 1.0
_WRITER_WAITS_MAX: Final = 10.0
NOTE_WAITS_MAX: Final = 0.2
_LOOK: Final = 0.005
_NAME_BYTES_MAX: Final = 64


def home() -> Path:
    """The directory of this user's contexts: `$LEDGERD_HOME`, else `$XDG_CONFIG_HOME/ledgerd`, else `~/.config/ledgerd`."""
    for variable, below in (("LEDGERD_HOME", ""), ("XDG_CONFIG_HOME", "ledgerd"), ("HOME", ".config/ledgerd")):
        value = os.environ.get(variable)
        if value:
            return Path(value) / below
    raise refusal(
        "BAD_FILE",
        "no directory for contexts",
        found="LEDGERD_HOME, XDG_CONFIG_HOME and HOME are not set",
        wanted="one of these variables",
        next="set LEDGERD_HOME to a directory",
    )


def bad_file(path: Path, found: str, wanted: str = "", next: str = "") -> Refusal:
    """The refusal of a file that cannot be used."""
    return refusal("BAD_FILE", f"cannot use {path}", found=found, wanted=wanted, next=next)


def read(path: Path) -> str:
    """Reads a text file of limited size."""
    advice = {"wanted": "the file of a stored context", "next": "enrol again, or restore the file"}
    try:
        with path.open("rb") as file:
            content = file.read(_FILE_BYTES_MAX + 1)
        text = content.decode()
    except (OSError, UnicodeDecodeError) as error:
        raise bad_file(path, str(error), **advice) from error
    if len(content) > _FILE_BYTES_MAX:
        raise bad_file(path, f"more than {_FILE_BYTES_MAX} bytes", **advice)
    return text


def read_secret(path: Path) -> str:
    """Reads a file that only its owner may read; refuses one that others can."""
    with contextlib.suppress(OSError):
        mode = stat.S_IMODE(path.stat().st_mode)
        if mode & _OTHERS:
            raise bad_file(
                path,
                f"mode {mode:04o}: other users can read or change the key",
                wanted=f"mode {_SECRET_MODE:04o}",
                next=f"chmod 600 {path}, and enrol again if others may have read it",
            )
    return read(path)


@contextlib.contextmanager
def reading(home: Path) -> Iterator[None]:
    """Held while contexts are read, beside other readers. A writer that was stopped is not waited for."""
    try:
        file = (home / _LOCK).open("rb")
    except OSError:
        # Where nobody has ever written, or nobody may, there is nothing to wait for.
        yield
        return
    with file:
        _wait(_READER_WAITS_MAX, lambda: _locked(file.fileno(), fcntl.LOCK_SH))
        yield


@contextlib.contextmanager
def changing(home: Path, patience: float = _WRITER_WAITS_MAX) -> Iterator[None]:
    """Held while contexts are changed, alone."""
    path = home / _LOCK
    try:
        make_directory(home)
        descriptor = os.open(path, os.O_CREAT | os.O_WRONLY | os.O_CLOEXEC, _SECRET_MODE)
    except OSError as error:
        raise unwritable(path, error) from error
    try:
        if not _wait(patience, lambda: _locked(descriptor, fcntl.LOCK_EX)):
            raise refusal(
                "BAD_FILE",
                f"another program is changing the contexts in {home}",
                found=f"a lock on {path}",
                wanted="one change at a time",
                next=f"wait for that program, or end it: fuser {path}",
            )
        yield
    finally:
        os.close(descriptor)


def _locked(descriptor: int, kind: int) -> bool:
    try:
        fcntl.flock(descriptor, kind | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _wait(patience: float, so: Callable[[], bool]) -> bool:
    deadline = time.monotonic() + patience
    while not so():
        if time.monotonic() >= deadline:
            return False
        time.sleep(_LOOK)
    return True


def unwritable(path: Path, error: OSError) -> Refusal:
    """The refusal of a place where nothing can be written."""
    return refusal(
        "BAD_FILE",
        f"cannot write {path}",
        found=str(error),
        wanted="a place to store a context",
        next="check the owner and the free space of the directory, or set LEDGERD_HOME to another",
    )


def finish_replacement(contexts: Path, name: str) -> None:
    """Brings a directory back whose replacement was cut off between the two renames."""
    current, old = contexts / name, contexts / f".{name}.old"
    if current.exists() or not old.exists():
        return
    try:
        old.rename(current)
    except OSError as error:
        # Perhaps somebody else was quicker.
        if not current.exists():
            raise bad_file(old, str(error)) from error


def replace_directory(contexts: Path, name: str, content: Mapping[str, str]) -> None:
    """Writes the directory `name` below `contexts` with these files: all of them or none. Call it under `changing`."""
    finish_replacement(contexts, name)
    current, new, old = contexts / name, contexts / f".{name}.new", contexts / f".{name}.old"
    try:
        for leftover in (new, old):
            remove(leftover)
        new.mkdir(mode=_DIRECTORY_MODE)
        for file, text in content.items():
            _create(new / file, text)
        _sync(new)
        if current.exists():
            current.rename(old)
        new.rename(current)
        _sync(contexts)
        remove(old)
    except OSError as error:
        raise unwritable(current, error) from error


def replace_file(directory: Path, name: str, text: str) -> None:
    """Writes one file in a directory that exists: the new content or the old one, never a part."""
    new = directory / f"{name}.new"
    try:
        with contextlib.suppress(FileNotFoundError):
            new.unlink()
        _create(new, text)
        new.rename(directory / name)
        _sync(directory)
    except OSError as error:
        with contextlib.suppress(OSError):
            new.unlink()
        raise unwritable(directory / name, error) from error


def make_directory(path: Path) -> None:
    """Makes a directory for its owner only, and those above it."""
    if path.is_dir():
        return
    make_directory(path.parent)
    try:
        path.mkdir(mode=_DIRECTORY_MODE, exist_ok=True)
    except OSError as error:
        raise unwritable(path, error) from error


def remove(directory: Path) -> None:
    """Removes a directory with all that is in it, if it is there."""
    with contextlib.suppress(FileNotFoundError):
        shutil.rmtree(directory)


def _create(path: Path, text: str) -> None:
    descriptor = os.open(path, os.O_CREAT | os.O_EXCL | os.O_WRONLY | os.O_CLOEXEC, _SECRET_MODE)
    with os.fdopen(descriptor, "w", encoding="utf-8", newline="") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def _sync(directory: Path) -> None:
    descriptor = os.open(directory, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def check_name(name: str) -> None:
    """A context may have every name that an identity can be registered with, and no other."""
    if 0 < len(name.encode()) <= _NAME_BYTES_MAX and name[0] not in ".-" and all(c.isalnum() or c in "-_." for c in name):
        return
    raise refusal(
        "NO_CONTEXT",
        "the name of the context is not usable",
        found=repr(name[:_NAME_BYTES_MAX]),
        wanted=f'1 to {_NAME_BYTES_MAX} bytes of letters, digits, "-", "_" and "."',
        next="choose another name",
    )
