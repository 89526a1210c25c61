"""Work apart from this process: in a child that answers questions, in forked children, or as side work.

A `ChildProcess` is bounded in time and memory: what may hang, take all memory or end its process does so
there, and the caller gets an answer that says so.

`side_by_side` works on several things at a time, with results as if done one after the other. Threads would
fight over the interpreter's lock, which is held half of the time; a child that is forked has everything its
parent has without a copy, and sends back its result.

Side work only judges or draws a result: where it fails, the result stays and a finding says so.
"""

import ctypes
import gc
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
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import IO, TYPE_CHECKING, BinaryIO, Literal, TypeAlias, TypeVar, cast

import numpy as np

from imucal.errors import DataError
from imucal.findings import Finding
from imucal.frozen import frozen

if TYPE_CHECKING:
    from multiprocessing.context import ForkProcess

#: done: it answered; failed: it raised; late: it took too long; ended: its process did, or was ended.
Outcome: TypeAlias = Literal["done", "failed", "late", "ended"]
#: What a limit of memory counts: all addresses, or what a process has written or may write of its own.
Counted: TypeAlias = Literal["addresses", "data"]

_LENGTH = struct.Struct("<Q")
_START = "import sys; sys.path[:] = {path!r}; from imucal.processes import serve; serve()"
#: Seconds between looks at whether the parent is still there.
_LOOK_S = 1.0
#: Of what a child wrote on standard error before it ended, so many bytes are read.
_WORDS = 2000
#: The thread of `imucal.readers.checksums`.
CHECKSUMS = "imucal checksums"
#: Threads that hold no lock a child needs: ours, by its name, and that of rich's progress bars, by its class.
_HARMLESS = frozenset({CHECKSUMS, "_RefreshThread"})
#: Which warnings of children have been shown, as Python keeps it for each module.
_SEEN: dict[str | tuple[str, type[Warning], int], int] = {}
#: What Python 3.12 and later say of a fork beside threads, also those of libraries.
_FORK_WARNING = r".*multi-threaded, use of fork"
#: How calculations end on data that they were not made for.
_NUMERIC = (ArithmeticError, np.linalg.LinAlgError)

T = TypeVar("T")
R = TypeVar("R")


@frozen
class Answer:
    """How a question ended: with the `value` that the function returned, where it is done.

    `words` are the error's type and text, where it failed, or what the child wrote last, where it ended;
    `code` is then its exit code, negative for a signal, as `subprocess.Popen.returncode`.
    """

    outcome: Outcome
    value: object = None
    words: str = ""
    code: int = 0


class ChildClosedError(Exception):
    """A question was put to a child that was closed: nobody waits for its answer."""


class ChildProcess:
    """A process that answers one question at a time.

    It has the variables of `environment` besides those of this process, where None takes one away; its
    limit of memory counts what `counted` says; it works in `folder`, or in this process's where that is
    None.
    """

    def __init__(
        self,
        *,
        environment: Mapping[str, str | None] | None = None,
        counted: Counted = "addresses",
        folder: str | None = None,
    ) -> None:
        self._environment, self._counted, self._folder = environment or {}, counted, folder
        self._process: subprocess.Popen[bytes] | None = None
        self._said: IO[bytes] | None = None
        self._lock = threading.Lock()
        self._closed = False

    def ask(self, function: Callable[..., object], *args: object, seconds: float, memory: int) -> Answer:
        """Call a function of a module in the child; all can be pickled.

        It is ended after so many seconds, and may take so many bytes of memory, where the operating system
        can limit it. An OSError says that the child can't be started, a ChildClosedError that it was
        closed, before or meanwhile.
        """
        question = pickle.dumps((self._counted, memory, function, args))
        with self._lock:
            process = self._started()
            late = threading.Event()

            def end() -> None:
                late.set()
                process.kill()

            timer = threading.Timer(seconds, end)
            # An interrupt may come while it starts: this process must not wait for it at its end.
            timer.daemon = True
            try:
                timer.start()
                _send(cast("BinaryIO", process.stdin), question)
                answer = _receive(cast("BinaryIO", process.stdout))
            except OSError:
                answer = None
            except BaseException:
                # Interrupted: what the child answers now nobody waits for.
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
            self._said = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
            self._process = subprocess.Popen(  # noqa: S603 - this very interpreter
                [sys.executable, "-c", _START.format(path=own_path())],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._said,
                env={k: v for k, v in {**os.environ, **self._environment}.items() if v is not None},
                cwd=self._folder,
            )
            # It may have been closed while it started.
            if self._closed:
                self._process.kill()
        return self._process

    def close(self) -> None:
        """Have no more questions answered, nor the one in hand, which another thread may wait for."""
        self._closed = True
        if (process := self._process) is not None:
            process.kill()

    def _refuse_closed(self) -> None:
        if self._closed:
            raise ChildClosedError

    def end(self) -> str:
        """End the process, if there is one; return what it wrote last on standard error."""
        if self._process is not None:
            self._process.kill()
            # Closes the pipes and takes the exit code.
            self._process.communicate()
            self._process = None
        if self._said is None:
            return ""
        with self._said as said:
            said.seek(max(said.seek(0, os.SEEK_END) - _WORDS, 0))
            words = said.read().decode("utf-8", "replace")
        self._said = None
        return words


def own_path() -> list[str]:
    """Return the folders of modules that nobody else could have put one into.

    A folder that all users share, or one of somebody else's in such a folder, is left out: what stands there
    under the name of a package would run with this user's rights. What the interpreter itself and this
    package are in stays.
    """
    package = str(Path(__file__).parents[1])
    return [folder for folder in sys.path if folder == package or _is_private(Path(folder))]


def _is_private(folder: Path) -> bool:
    """Return whether all who may put files into a folder, or another folder in its place, are trusted."""
    if not hasattr(os, "getuid") or any(map(folder.is_relative_to, (sys.prefix, sys.base_prefix))):
        return True
    folder = folder.resolve()
    try:
        infos = [place.stat() for place in (folder, *folder.parents)]
    except OSError:
        # It may be made by anybody yet.
        return False
    for own, above in itertools.pairwise(infos):
        kept = above.st_mode & stat.S_ISVTX and own.st_uid in {0, os.getuid()}
        if above.st_mode & stat.S_IWOTH and not kept:
            return False
    return not infos[0].st_mode & stat.S_IWOTH


def serve() -> None:
    """Answer questions on standard input until it ends: the child's side."""
    # An interrupt is the parent's to handle: it ends the child.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=leave_with, args=(os.getppid(),), daemon=True).start()
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    # What the packages print is nobody's.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    while (question := _receive(sys.stdin.buffer)) is not None:
        try:
            counted, memory, function, args = pickle.loads(question)  # noqa: S301 - from this package's own process
            _limit_memory(counted, memory)
            answer = pickle.dumps(Answer(outcome="done", value=function(*args)), protocol=5)
        except BaseException as error:  # noqa: BLE001 - panics of Rust are no Exceptions
            text = " ".join(str(error).split())[:300]
            answer = pickle.dumps(Answer(outcome="failed", words=f"{type(error).__name__}: {text}"))
        _send(answers, answer)


def leave_with(parent: int) -> None:
    """End this process, whatever it does, once its parent has ended."""
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    os._exit(1)


def _limit_memory(counted: Counted, size: int) -> None:
    try:
        import resource
    except ImportError:
        return
    kind = resource.RLIMIT_AS if counted == "addresses" else resource.RLIMIT_DATA
    # A batch scheduler's own limit (`ulimit -v`) can't be raised.
    hard = resource.getrlimit(kind)[1]
    resource.setrlimit(kind, (size if hard == resource.RLIM_INFINITY else min(size, hard), hard))


def _send(stream: BinaryIO, data: bytes) -> None:
    stream.write(_LENGTH.pack(len(data)))
    stream.write(data)
    stream.flush()


def _receive(stream: BinaryIO) -> bytes | None:
    """Return the next message; None where the stream has ended."""
    head = stream.read(_LENGTH.size)
    if len(head) < _LENGTH.size:
        return None
    (size,) = _LENGTH.unpack(head)
    data = stream.read(size)
    return data if len(data) == size else None


def may_fork() -> bool:
    """Whether child processes may be forked here.

    Not elsewhere than on Linux, where libraries do not bear it; in a child of `multiprocessing`; beside other
    threads of Python, whose locks a child would find locked for ever; under a debugger or a profiler.
    """
    if not sys.platform.startswith("linux") or sys.gettrace() or sys.getprofile():
        return False
    others = [thread for thread in threading.enumerate() if thread is not threading.main_thread()]
    return (
        multiprocessing.parent_process() is None
        and threading.current_thread() is threading.main_thread()
        and all(_HARMLESS & {thread.name, type(thread).__name__} for thread in others)
    )


def side_by_side(
    work: Callable[[T], R],
    items: Sequence[T],
    *,
    workers: int,
    done: Callable[[int, T | None], None] | None = None,
) -> list[R]:
    """Return what `work` makes of each item, in their order.

    Items are begun in their order, each in one of at most `workers` forked processes, or here one by one
    where none may be forked. Where one fails, or its process is killed, no other is begun there; that one
    and what is left are done here one by one, so that an error is raised as if all had been. No process
    outlives the call, nor this process. `done` is called with the number of items done and the first that
    is not done, None when all are.
    """
    found: dict[int, R] = {}

    def tell() -> None:
        if done:
            done(len(found), next((item for index, item in enumerate(items) if index not in found), None))

    if workers > 1 and len(items) > 1 and may_fork():
        _in_children(work, items, min(workers, len(items)), found, tell)
    for index, item in enumerate(items):
        if index not in found:
            tell()
            found[index] = work(item)
    tell()
    return [found[index] for index in range(len(items))]


def trim_memory() -> None:
    """Hand memory that was freed back to the system, where the C library keeps it (glibc).

    What stands free among what is in use counts as this process's, and again as each child's that writes
    to it.
    """
    if sys.platform.startswith("linux"):
        with suppress(AttributeError, OSError):
            ctypes.CDLL(None).malloc_trim(0)


def _in_children(
    work: Callable[[T], R], items: Sequence[T], workers: int, found: dict[int, R], tell: Callable[[], None]
) -> None:
    """Add the results of children to `found`, until all are there or one could not be made."""
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
            tell()
            for pipe in [pipe for pipe in wait(list(in_hand)) if isinstance(pipe, Connection)]:
                index = in_hand.pop(pipe)
                if not _received(pipe, index, items, found):
                    todo = iter(())
                elif (following := next(todo, None)) is not None:
                    _give(pipe, following, in_hand)
            if len(found) == len(items):
                return
    finally:
        # They have nothing to tidy up.
        for process in processes:
            process.kill()
        for process in processes:
            process.join()


def _start(work: Callable[[T], R], items: Sequence[T], processes: "list[ForkProcess]") -> Connection | None:
    """Add a child to `processes` and return its pipe; None where the system gives no more."""
    context = multiprocessing.get_context("fork")
    # An interrupt waits until the child is known; the child never gets it, its parent ends it.
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
    """Hand out an item; that a child is gone is seen when its result is read."""
    in_hand[pipe] = index
    with suppress(OSError):
        pipe.send_bytes(b"%d" % index)


class _Sender(pickle.Pickler):
    """Packs a result; the item that it is of is named in it, not sent: the parent has it."""

    item: object

    def persistent_id(self, obj: object) -> str | None:
        return "item" if obj is self.item else None


class _Receiver(pickle.Unpickler):
    """Unpacks what a `_Sender` has packed."""

    item: object

    def persistent_load(self, pid: object) -> object:  # noqa: ARG002 - there is one
        return self.item


def _received(pipe: Connection, index: int, items: Sequence[T], found: dict[int, R]) -> bool:
    """Add a child's result to `found`, and show its warnings; False where it has ended without one."""
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
    """Send the result and the warnings of each item that is asked for: the child's side.

    Whatever fails ends the child without a word: its parent does the same again, and says it.
    """
    try:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        threading.Thread(target=leave_with, args=(parent,), daemon=True).start()
        # What is there stays: the collector would write to its pages, which parent and child share.
        gc.freeze()
        while True:
            index = int(pipe.recv_bytes())
            with warnings.catch_warnings(record=True) as caught:
                result = work(items[index])
            said = [(one.message, one.category, one.filename, one.lineno) for one in caught]
            packed = io.BytesIO()
            sender = _Sender(packed, protocol=5)
            sender.item = items[index]
            sender.dump((result, said))
            pipe.send_bytes(packed.getbuffer())
    finally:
        # At once: nothing that stands in buffers of the parent's is written twice.
        os._exit(1)


def try_side_work(
    make: Callable[[], T], otherwise: R, *, what: str, code: str, axis: str | None = None
) -> tuple[T | R, tuple[Finding, ...]]:
    """Return what `make` gives and no finding; or `otherwise` and the finding that it could not.

    That it can't judge some data, as a DataError or a failed calculation says, is a finding. A fault of the
    program is one too, so that it costs nobody hours of data; with IMUCAL_DEBUG set it is raised instead.
    Its sentence begins with `what`, such as ``The fit of the Allan curve failed``.
    """
    try:
        return make(), ()
    except DataError as error:
        why = str(error).removeprefix(f"{axis}: ")
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
    """Return the findings of a judge, or the one that it could not judge."""
    found, failed = try_side_work(judge, (), what=what, code=code, axis=axis)
    return found + failed


def faults_are_raised() -> bool:
    """Whether faults of the program are raised: IMUCAL_DEBUG is set."""
    return bool(os.environ.get("IMUCAL_DEBUG"))


def _last_words(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".rstrip(". ")
