"""A child process that answers questions, bounded in time and memory.

What may hang, take all memory or end its process does so in the child: the caller gets an answer that says
so. A child is started at its first question, and anew where it has ended; it leaves when its parent does.
"""

import os
import pickle
import signal
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import BinaryIO, Literal, TypeAlias, cast

#: done: it answered; failed: it raised; late: it took too long; ended: its process did, or was ended.
Outcome: TypeAlias = Literal["done", "failed", "late", "ended"]
#: What a limit of memory counts: all addresses, or what a process has written or may write of its own.
Counted: TypeAlias = Literal["addresses", "data"]

_LENGTH = struct.Struct("<Q")
_START = "import sys; sys.path[:] = {path!r}; from imucal.child_process import serve; serve()"
#: Seconds between looks at whether the parent is still there.
_LOOK_S = 1.0
#: Of what a child wrote on standard error before it ended, so many bytes are read.
_WORDS = 2000


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """How a question ended.

    Attributes
    ----------
    outcome
        What became of it.
    value
        What the function returned, where it is done.
    words
        The error's type and text, where it failed; what the child wrote last, where it ended.
    code
        Exit code of a child that ended, negative for a signal, as `subprocess.Popen.returncode`.
    """

    outcome: Outcome
    value: object = None
    words: str = ""
    code: int = 0


class ChildProcess:
    """A process that answers one question at a time.

    Parameters
    ----------
    environment
        Variables that it has besides those of this process; None takes one away.
    counted
        What its limit of memory counts.
    folder
        Its working folder; None for that of this process.
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
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as this object
        self._lock = threading.Lock()

    def ask(
        self,
        function: Callable[..., object],
        *args: object,
        seconds: float,
        memory: int,
        **kwargs: object,
    ) -> Answer:
        """Call a function of a module in the child.

        Parameters
        ----------
        function, args, kwargs
            What to call; all can be pickled.
        seconds
            After these it is ended.
        memory
            Bytes that it may take, where the operating system can limit it.

        Raises
        ------
        OSError
            If the child can't be started.
        """
        question = pickle.dumps((self._counted, memory, function, args, kwargs))
        with self._lock:
            process = self._started()
            late = threading.Event()

            def end() -> None:
                late.set()
                process.kill()

            timer = threading.Timer(seconds, end)
            timer.start()
            try:
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
                done, result = pickle.loads(answer)  # noqa: S301 - from this package's own process
                return (
                    Answer(outcome="done", value=result) if done else Answer(outcome="failed", words=result)
                )
            self.end()
            return Answer(
                outcome="late" if late.is_set() else "ended",
                words=self._last_words(),
                code=process.returncode,
            )

    @property
    def pid(self) -> int | None:
        """Number of the process, while there is one."""
        return None if self._process is None else self._process.pid

    def _started(self) -> subprocess.Popen[bytes]:
        if self._process is None or self._process.poll() is not None:
            self.end()
            self._said.seek(0)
            self._said.truncate()
            self._process = subprocess.Popen(  # noqa: S603 - this very interpreter
                [sys.executable, "-c", _START.format(path=sys.path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=self._said,
                env={k: v for k, v in {**os.environ, **self._environment}.items() if v is not None},
                cwd=self._folder,
            )
        return self._process

    def _last_words(self) -> str:
        size = self._said.seek(0, os.SEEK_END)
        self._said.seek(max(size - _WORDS, 0))
        return self._said.read().decode("utf-8", "replace")

    def end(self) -> None:
        """End the process, if there is one."""
        if self._process is not None:
            self._process.kill()
            # Closes the pipes and takes the exit code.
            self._process.communicate()
            self._process = None


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
            counted, memory, function, args, kwargs = pickle.loads(question)  # noqa: S301 - from this package's own process
            _limit_memory(counted, memory)
            answer = pickle.dumps((True, function(*args, **kwargs)), protocol=5)
        except BaseException as error:  # noqa: BLE001 - panics of Rust are no Exceptions
            text = " ".join(str(error).split())[:300]
            answer = pickle.dumps((False, f"{type(error).__name__}: {text}"))
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
    resource.setrlimit(kind, (size, resource.RLIM_INFINITY))


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
