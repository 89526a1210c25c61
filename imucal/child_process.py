"""A child process that answers questions: for code that may hang, use all memory or crash.

Each question has a limit of time and of memory. The child is a new interpreter: `multiprocessing` would
import the user's main module again, and can't give a child another environment.
"""

import ctypes
import importlib
import itertools
import os
import pickle
import signal
import stat
import struct
import subprocess
import sys
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, BinaryIO, Literal, TypeAlias, cast

__all__ = ["Answer", "ChildClosedError", "ChildProcess", "end_with_parent", "own_path", "serve"]

#: late: it took too long; ended: its process crashed or was killed.
Outcome: TypeAlias = Literal["done", "failed", "no-memory", "late", "ended"]
#: The whole address space, or private writable memory.
Counted: TypeAlias = Literal["addresses", "data"]

#: Length of a message in front of it: eight bytes, little-endian.
_LENGTH = struct.Struct("<Q")
#: Script of the child.
_START = "import sys; sys.path[:] = {path!r}; from imucal.child_process import serve; serve(*{preloaded!r})"
#: Argument of prctl: the signal that a process gets when its parent ends.
_PARENT_DEATH_SIGNAL = 1
#: Seconds between checks that the parent is alive.
_LOOK_S = 1.0
#: Bytes of a child's standard error that are kept.
_WORDS = 2000
#: Warning of Python 3.12 and later.
FORK_WARNING = r".*multi-threaded, use of fork"


@dataclass(frozen=True, kw_only=True)
class Answer:
    """The outcome of a question, and the `value` that the function returned if it is done.

    It is ``no-memory`` after a MemoryError. `words` contains the type and text of another error, or the last
    output of a child that ended; `code` is then its exit code, negative for a signal.
    """

    outcome: Outcome
    value: object = None
    words: str = ""
    code: int = 0


class ChildClosedError(Exception):
    """The child was closed before it answered."""


class ChildProcess:
    """A process that answers one question at a time.

    `environment` adds variables to the environment of this process; None removes one. `counted` is the kind
    of memory that is limited. The child works in `folder`, or in the current folder if None. If modules are
    `preloaded`, the child imports them once and answers each question in a process that it forks, where the
    system can fork safely.
    """

    def __init__(
        self,
        *,
        environment: Mapping[str, str | None] | None = None,
        counted: Counted = "addresses",
        folder: str | None = None,
        preloaded: Sequence[str] = (),
    ) -> None:
        self._environment, self._counted, self._folder = environment or {}, counted, folder
        self._preloaded = tuple(preloaded)
        self._process: subprocess.Popen[bytes] | None = None
        self._errors: IO[bytes] | None = None
        self._lock = threading.Lock()
        self._closed = False

    def ask(self, function: Callable[..., object], *args: object, seconds: float, memory: int) -> Answer:
        """Call a function of a module in the child; function, arguments and result are pickled.

        The child is killed after `seconds`, and may use `memory` bytes if the operating system has limits.
        Raises OSError if the child can't be started, and ChildClosedError if it was closed.
        """
        question = pickle.dumps((self._counted, memory, function, args))
        with self._lock:
            process = self._started()
            late = threading.Event()

            def end() -> None:
                late.set()
                process.kill()

            timer = threading.Timer(seconds, end)
            # After an interrupt during the start, this process must not wait for the timer.
            timer.daemon = True
            try:
                timer.start()
                _send(cast("BinaryIO", process.stdin), question)
                answer = _receive(cast("BinaryIO", process.stdout))
            except OSError:
                answer = None
            except BaseException:
                self.end()
                raise
            finally:
                timer.cancel()
            if answer is not None:
                found: Answer = pickle.loads(answer)  # noqa: S301 - from this package's own process
                return found
            words = self.end()
            self._refuse_closed()
            outcome: Outcome = "late" if late.is_set() else "ended"
            return Answer(outcome=outcome, words=words, code=process.returncode)

    def _started(self) -> subprocess.Popen[bytes]:
        self._refuse_closed()
        if self._process is None or self._process.poll() is not None:
            self.end()
            self._errors = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
            self._process = subprocess.Popen(  # noqa: S603 - this very interpreter
                [sys.executable, "-c", _START.format(path=own_path(), preloaded=self._preloaded)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._errors,
                env={k: v for k, v in {**os.environ, **self._environment}.items() if v is not None},
                cwd=self._folder,
            )
            # Another thread may have closed it during the start.
            if self._closed:
                self._process.kill()
        return self._process

    def close(self) -> None:
        """Kill the child, also while another thread waits for its answer."""
        self._closed = True
        if (process := self._process) is not None:
            process.kill()

    def _refuse_closed(self) -> None:
        if self._closed:
            raise ChildClosedError

    def end(self) -> str:
        """Kill the process; return the end of its standard error."""
        if self._process is not None:
            self._process.kill()
            for pipe in (self._process.stdin, self._process.stdout):
                with suppress(OSError):
                    cast("IO[bytes]", pipe).close()
            # Not `communicate`: it waits for all processes that inherited the pipes, also for a stopped fork.
            self._process.wait()
            self._process = None
        if self._errors is None:
            return ""
        with self._errors as file:
            file.seek(max(file.seek(0, os.SEEK_END) - _WORDS, 0))
            words = file.read().decode("utf-8", "replace")
        self._errors = None
        return words


def own_path() -> list[str]:
    """Return the entries of `sys.path` that other users can't write to.

    A module in a shared folder would run with the rights of this user.
    """
    package = str(Path(__file__).parents[1])
    return [folder for folder in sys.path if folder == package or _is_private(Path(folder))]


def _is_private(folder: Path) -> bool:
    """Return whether only trusted users can write to a folder or replace it."""
    if not hasattr(os, "getuid") or any(map(folder.is_relative_to, (sys.prefix, sys.base_prefix))):
        return True
    folder = folder.resolve()
    try:
        infos = [place.stat() for place in (folder, *folder.parents)]
    except OSError:
        # Anybody may create it.
        return False
    for own, above in itertools.pairwise(infos):
        kept = above.st_mode & stat.S_ISVTX and own.st_uid in {0, os.getuid()}
        if above.st_mode & stat.S_IWOTH and not kept:
            return False
    return not infos[0].st_mode & stat.S_IWOTH


def serve(*preloaded: str) -> None:
    """Answer questions on standard input until it ends; runs in the child."""
    # The parent kills the child after an interrupt.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_leave_with, args=(os.getppid(),), daemon=True).start()
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    for module in preloaded:
        importlib.import_module(module)
    answered = _answered_in_fork if preloaded and sys.platform.startswith("linux") else _answered
    while (question := _receive(sys.stdin.buffer)) is not None:
        _send(answers, answered(question))


def _answered(question: bytes) -> bytes:
    """Return the pickled answer to a pickled question."""
    try:
        counted, memory, function, args = pickle.loads(question)  # noqa: S301 - from this package's own process
        _limit_memory(counted, memory)
        return pickle.dumps(Answer(outcome="done", value=function(*args)), protocol=5)
    except MemoryError:
        return pickle.dumps(Answer(outcome="no-memory"))
    except BaseException as error:  # noqa: BLE001 - panics of Rust are no Exceptions
        text = " ".join(str(error).split())[:300]
        return pickle.dumps(Answer(outcome="failed", words=f"{type(error).__name__}: {text}"))


def _answered_in_fork(question: bytes) -> bytes:
    """Return the pickled answer of a forked process: a crash or leaked memory costs this question only."""
    reader, writer = os.pipe()
    server = os.getpid()
    with warnings.catch_warnings():
        # The other thread only sleeps.
        warnings.filterwarnings("ignore", FORK_WARNING, DeprecationWarning)
        process = os.fork()
    if not process:
        end_with_parent(server)
        try:
            with os.fdopen(writer, "wb") as stream:
                stream.write(_answered(question))
            os._exit(0)
        finally:
            os._exit(1)
    os.close(writer)
    with os.fdopen(reader, "rb") as stream:
        answer = stream.read()
    _, status = os.waitpid(process, 0)
    code = os.waitstatus_to_exitcode(status)
    return answer if code == 0 else pickle.dumps(Answer(outcome="ended", code=code))


def end_with_parent(parent: int) -> None:
    """Let the system kill this process when its parent ends, also in a call that never returns."""
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def _leave_with(parent: int) -> None:
    """End this process when its parent has ended."""
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    os._exit(1)


def _limit_memory(counted: Counted, size: int) -> None:
    try:
        import resource
    except ImportError:
        return
    kind = resource.RLIMIT_AS if counted == "addresses" else resource.RLIMIT_DATA
    # The hard limit of a batch scheduler (`ulimit -v`) can't be raised.
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (size if hard == resource.RLIM_INFINITY else min(size, hard), hard))


def _send(stream: BinaryIO, data: bytes) -> None:
    stream.write(_LENGTH.pack(len(data)))
    stream.write(data)
    stream.flush()


def _receive(stream: BinaryIO) -> bytes | None:
    """Return the next message; None at the end."""
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        return None
    (size,) = _LENGTH.unpack(head)
    data = stream.read(size)
    return data if len(data) == size else None
