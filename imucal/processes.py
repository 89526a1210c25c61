"""Work in other processes: a child that answers questions, forked children; and optional work that may fail.

Code that may hang, use all memory or crash runs in a `ChildProcess`, with limits of time and memory.

`side_by_side` forks, because threads would wait for the interpreter's lock. A forked child sees the data of
its parent without a copy.

Side work only judges or draws a result: if it fails, a finding reports the failure.
"""

import ctypes
import gc
import importlib
import io
import itertools
import multiprocessing
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
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import IO, TYPE_CHECKING, BinaryIO, Literal, TypeAlias, TypeVar, cast

import numpy as np

from imucal.errors import DataError
from imucal.findings import Finding

if TYPE_CHECKING:
    from multiprocessing.context import ForkProcess

#: late: it took too long; ended: its process crashed or was killed.
Outcome: TypeAlias = Literal["done", "failed", "no-memory", "late", "ended"]
#: The whole address space, or private writable memory.
Counted: TypeAlias = Literal["addresses", "data"]

_LENGTH = struct.Struct("<Q")
_START = "import sys; sys.path[:] = {path!r}; from imucal.processes import serve; serve(*{preloaded!r})"
#: Argument of prctl: the signal that a process gets when its parent ends.
_PARENT_DEATH_SIGNAL = 1
#: Seconds between checks that the parent is alive.
_LOOK_S = 1.0
#: Bytes of a child's standard error that are kept.
_WORDS = 2000
#: Name of the thread of `imucal.readers.checksums`.
CHECKSUMS = "imucal checksums"
#: Start of the names of fsspec's threads, which are idle after a download.
DOWNLOADS = "fsspecIO"
#: Threads without locks that a child needs: ours, the class of rich's progress bars, and fsspec's.
_HARMLESS = frozenset({CHECKSUMS, "_RefreshThread", DOWNLOADS})
#: Warnings that were shown, as Python registers them for each module.
_SEEN: dict[str | tuple[str, type[Warning], int], int] = {}
#: Warning of Python 3.12 and later.
_FORK_WARNING = r".*multi-threaded, use of fork"
_NUMERIC = (ArithmeticError, np.linalg.LinAlgError)

T = TypeVar("T")
R = TypeVar("R")


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
            # Close the pipes and fetch the exit code.
            self._process.communicate()
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
    threading.Thread(target=leave_with, args=(os.getppid(),), daemon=True).start()
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
        warnings.filterwarnings("ignore", _FORK_WARNING, DeprecationWarning)
        process = os.fork()
    if not process:
        _end_with_parent(server)
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


def _end_with_parent(parent: int) -> None:
    """Let the system kill this process when its parent ends, also in a call that never returns."""
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).prctl(_PARENT_DEATH_SIGNAL, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def leave_with(parent: int) -> None:
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


def may_fork() -> bool:
    """Return whether this process can fork safely.

    It can't on other systems than Linux; in a child of `multiprocessing`; with other Python threads, whose
    locks would stay locked in the child; under a debugger or a profiler.
    """
    if not sys.platform.startswith("linux") or sys.gettrace() or sys.getprofile():
        return False
    others = [thread for thread in threading.enumerate() if thread is not threading.main_thread()]
    return (
        multiprocessing.parent_process() is None
        and threading.current_thread() is threading.main_thread()
        and all(_HARMLESS & {thread.name.partition("_")[0], type(thread).__name__} for thread in others)
    )


def side_by_side(
    work: Callable[[T], R],
    items: Sequence[T],
    *,
    workers: int,
    done: Callable[[int, T | None], None] | None = None,
) -> list[R]:
    """Return `work(item)` for each item, in their order.

    At most `workers` forked processes work at a time; if forking is not safe, this process does all items. If
    an item fails or its process is killed, this process does that item and the remaining ones, so an error is
    raised as in a loop. No child outlives the call. `done` is called with the number of finished items and
    the first unfinished item, or None.
    """
    found: dict[int, R] = {}

    def notify() -> None:
        if done:
            done(len(found), next((item for index, item in enumerate(items) if index not in found), None))

    if workers > 1 and len(items) > 1 and may_fork():
        _in_children(work, items, min(workers, len(items)), found, notify)
    for index, item in enumerate(items):
        if index not in found:
            notify()
            found[index] = work(item)
    notify()
    return [found[index] for index in range(len(items))]


def trim_memory() -> None:
    """Return freed memory to the system if the C library is glibc.

    Otherwise freed pages count for this process, and again for each child that writes to them.
    """
    if sys.platform.startswith("linux"):
        with suppress(AttributeError, OSError):
            ctypes.CDLL(None).malloc_trim(0)


def _in_children(
    work: Callable[[T], R],
    items: Sequence[T],
    workers: int,
    found: dict[int, R],
    notify: Callable[[], None],
) -> None:
    """Add results to `found`, until all are there or one fails."""
    processes: list[ForkProcess] = []
    in_hand: dict[Connection, int] = {}
    trim_memory()
    try:
        for index in range(workers):
            pipe = _start(work, items, processes)
            if pipe is None:
                break
            _give(pipe, index, in_hand)
        todo = iter(range(len(in_hand), len(items)))
        while in_hand:
            notify()
            for pipe in [pipe for pipe in wait(list(in_hand)) if isinstance(pipe, Connection)]:
                index = in_hand.pop(pipe)
                if not _received(pipe, index, items, found):
                    todo = iter(())
                elif (following := next(todo, None)) is not None:
                    _give(pipe, following, in_hand)
            if len(found) == len(items):
                return
    finally:
        for process in processes:
            process.kill()
        for process in processes:
            process.join()


def _start(work: Callable[[T], R], items: Sequence[T], processes: "list[ForkProcess]") -> Connection | None:
    """Add a child to `processes` and return its pipe; None if the system refuses one."""
    context = multiprocessing.get_context("fork")
    # Block interrupts until the child is in the list. The child never gets one: its parent kills it.
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        ours, theirs = context.Pipe()
        with theirs, warnings.catch_warnings():
            warnings.filterwarnings("ignore", _FORK_WARNING, DeprecationWarning)
            process = context.Process(target=_serve, args=(work, items, theirs, os.getpid()), daemon=True)
            process.start()
        processes.append(process)
    except OSError:
        return None
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return ours


def _give(pipe: Connection, index: int, in_hand: dict[Connection, int]) -> None:
    """Send an index; if the child is gone, reading its result will show it."""
    in_hand[pipe] = index
    with suppress(OSError):
        pipe.send_bytes(b"%d" % index)


class _Sender(pickle.Pickler):
    """Pickles a result without the item, which the parent has."""

    item: object

    def persistent_id(self, obj: object) -> str | None:
        return "item" if obj is self.item else None


class _Receiver(pickle.Unpickler):
    item: object

    def persistent_load(self, pid: object) -> object:  # noqa: ARG002 - there is one
        return self.item


def _received(pipe: Connection, index: int, items: Sequence[T], found: dict[int, R]) -> bool:
    """Add a child's result to `found` and show its warnings; False if it ended without a result."""
    try:
        receiver = _Receiver(io.BytesIO(pipe.recv_bytes()))
    except (EOFError, OSError):
        return False
    receiver.item = items[index]
    found[index], caught = receiver.load()
    for message, category, file, line in caught:
        warnings.warn_explicit(message, category, file, line, registry=_SEEN)
    return True


def _serve(work: Callable[[T], R], items: Sequence[T], pipe: Connection, parent: int) -> None:
    """Send the result and the warnings of each requested item; runs in the child.

    An error ends the child silently: its parent repeats the work and raises the error.
    """
    try:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        threading.Thread(target=leave_with, args=(parent,), daemon=True).start()
        # Garbage collection would write to pages shared with the parent.
        gc.freeze()
        while True:
            index = int(pipe.recv_bytes())
            with warnings.catch_warnings(record=True) as caught:
                result = work(items[index])
            sentence = [(one.message, one.category, one.filename, one.lineno) for one in caught]
            packed = io.BytesIO()
            sender = _Sender(packed, protocol=5)
            sender.item = items[index]
            sender.dump((result, sentence))
            pipe.send_bytes(packed.getbuffer())
    finally:
        # Exit at once, so that the parent's buffers are not written twice.
        os._exit(1)


def try_side_work(
    make: Callable[[], T], otherwise: R, *, what: str, code: str, axis: str | None = None
) -> tuple[T | R, tuple[Finding, ...]]:
    """Return the result of `make` and no finding; or `otherwise` and a finding with the reason.

    A DataError and a failed calculation become a finding. So does a bug, so that it does not cost hours of
    data; with IMUCAL_DEBUG it is raised. The finding begins with `what`, such as ``The fit of the Allan curve
    failed``.
    """
    try:
        return make(), ()
    except DataError as error:
        why = error.sentence if error.place == axis else str(error)
    except _NUMERIC as error:
        why = f"the calculation failed ({_last_words(error)})"
    except Exception as error:
        if faults_are_raised():
            raise
        why = f"internal error ({_last_words(error)}); please report it, IMUCAL_DEBUG=1 shows where"
    return otherwise, (Finding("warning", code, f"{what}: {why}.", axis=axis),)


def findings_or_why_not(
    judge: Callable[[], tuple[Finding, ...]], *, what: str, code: str, axis: str | None = None
) -> tuple[Finding, ...]:
    """Return the findings of `judge`, or a finding with the reason why it failed."""
    found, failed = try_side_work(judge, (), what=what, code=code, axis=axis)
    return found + failed


def faults_are_raised() -> bool:
    """Return whether bugs are raised: IMUCAL_DEBUG is set."""
    return bool(os.environ.get("IMUCAL_DEBUG"))


def _last_words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".rstrip(". ")
