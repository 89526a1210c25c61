"""The cache of remote logs: complete files only, limited in size, safe between processes."""

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

import imucal
from imucal.errors import ReadError
from imucal.remote import RemoteLog
from imucal.remote.copies import cache_folder, cache_size, fetched
from imucal.remote.stores import identify
from tests.remote.web_server import WebServer

pytestmark = pytest.mark.usefixtures("cache", "no_waits")

BODY = bytes(range(256)) * 400  # 102 400 bytes

FETCH = """
import os, sys
from imucal.remote.copies import fetched
from imucal.remote.stores import identify
with fetched(identify(sys.argv[1])) as copy:
    print(len(copy.path.read_bytes()), flush=True)
"""


def start(url: str, script: str = FETCH) -> subprocess.Popen[str]:
    """Fetch a log in a separate process."""
    return subprocess.Popen(  # noqa: S603 - our own code
        [sys.executable, "-c", script, url],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        encoding="utf-8",
    )


def copies(cache: Path) -> list[str]:
    """Return the names of the copies in the cache, including incomplete ones and links."""
    return sorted(path.name for path in cache.glob("*/*"))


def use(url: str) -> RemoteLog:
    """Fetch a log and release it."""
    with fetched(identify(url)) as copy:
        assert copy.path.read_bytes() == BODY
        return copy.log


def test_the_least_recently_used_log_is_removed_first(
    web: WebServer, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cache of 250 kB gets three logs of 100 kB; using a log renews it."""
    monkeypatch.setenv("IMUCAL_CACHE_SIZE", "250k")
    urls = [web.add(f"/{name}", BODY) for name in "abc"]
    for age, url in ((30, urls[0]), (20, urls[1])):
        os.utime(cache / use(url).key, (time.time() - age,) * 2)
    use(urls[0])
    use(urls[2])
    assert copies(cache) == ["a", "c"]


def test_a_reader_does_not_lose_a_log_that_is_removed(
    web: WebServer, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A full cache removes the copy of the first log, but its reader has own links to the files.

    Readers may open the path at any time.
    """
    monkeypatch.setenv("IMUCAL_CACHE_SIZE", "150k")
    first, second = (web.add(f"/{name}", BODY) for name in "ab")
    with fetched(identify(first)) as copy, copy.path.open("rb") as opened:
        use(second)
        assert [path.name for path in cache.glob(f"{copy.log.key}/*")] == []
        assert copy.path.read_bytes() == opened.read() == BODY
    assert copies(cache) == ["b"]
    monkeypatch.setenv("IMUCAL_CACHE_SIZE", "0")
    use(first)
    assert list(cache.iterdir()) == []


def test_a_reader_in_another_process_does_not_lose_a_log(
    web: WebServer, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reader opens the log after this process has removed the copy."""
    reader = FETCH.replace("    print", "    print(sys.stdin.readline(), end='', flush=True)\n    print")
    url = web.add("/a", BODY)
    key = use(url).key
    process = start(url, reader)
    while not list(cache.glob(f"{key}.*.part/a")):
        assert process.poll() is None
        time.sleep(0.01)
    monkeypatch.setenv("IMUCAL_CACHE_SIZE", "150k")
    use(web.add("/b", BODY))
    assert not (cache / key).exists()
    assert process.communicate("go\n", timeout=60) == (f"go\n{len(BODY)}\n", "")
    assert copies(cache) == ["b"]


def test_a_download_does_not_prevent_forks(web: WebServer, cache: Path) -> None:
    """Axes are fitted in forked processes; fsspec's thread is idle then."""
    script = FETCH + "from imucal.parallel import may_fork, side_by_side\n"
    script += "print(may_fork(), side_by_side(str, [1, 2], workers=2))\n"
    out, err = start(web.add("/a", BODY), script).communicate(timeout=60)
    assert err == ""
    assert out.splitlines() == [str(len(BODY)), "True ['1', '2']"]
    assert copies(cache) == ["a"]


def test_other_files_in_the_folder_are_never_removed(
    web: WebServer, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The folder may be one of the user's."""
    monkeypatch.setenv("IMUCAL_CACHE_SIZE", "0")
    for name in ("recordings", f"{32 * 'a'}.part", "a.part"):
        (cache / name).mkdir(parents=True)
        (cache / name / "log.mcap").write_bytes(BODY)
        os.utime(cache / name / "log.mcap", (0, 0))
        os.utime(cache / name, (0, 0))
    use(web.add("/a", BODY))
    assert copies(cache) == ["log.mcap"] * 3


def test_a_log_with_keep_false_is_removed_after_use(web: WebServer, cache: Path) -> None:
    """Fleets use this option. A copy that was there is used and stays."""
    log = identify(web.add("/a", BODY), keep=False)
    with fetched(log) as copy:
        assert copy.path.read_bytes() == BODY
    assert list(cache.iterdir()) == []
    use(log.url)
    before = web.parts
    with fetched(log) as copy:
        assert copy.path.read_bytes() == BODY
    assert web.parts == before
    assert copies(cache) == ["a"]


def test_without_hard_links_nothing_is_kept(
    web: WebServer, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Some file systems have none, such as exFAT."""

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(1, os.strerror(1))

    monkeypatch.setattr(os, "link", refuse)
    use(web.add("/a", BODY))
    assert list(cache.iterdir()) == []


def test_a_copy_of_wrong_size_is_downloaded_again(web: WebServer, cache: Path) -> None:
    """The copy was cut."""
    url = web.add("/a", BODY)
    use(url)
    (path,) = cache.glob("*/a")
    path.write_bytes(BODY[:-1])
    use(url)


def test_two_processes_download_at_the_same_time(web: WebServer, cache: Path) -> None:
    """Both results are complete, and one copy is kept."""
    url = web.add("/a", BODY, delay_s=0.2)
    running = [start(url) for _ in range(2)]
    outputs = [process.communicate(timeout=60) for process in running]
    assert outputs == [(f"{len(BODY)}\n", "")] * 2
    assert copies(cache) == ["a"]
    before = web.parts
    use(url)
    assert web.parts == before


def test_a_copy_that_appears_during_a_download_is_replaced(web: WebServer, cache: Path) -> None:
    """Another process has downloaded the same object; its links stay valid."""
    log = identify(web.add("/a", BODY))
    with fetched(log) as first:
        shutil.rmtree(cache / log.key)

        def other_process(*_: int) -> None:
            use(log.url)

        with fetched(log, progress=other_process) as second:
            assert first.path.read_bytes() == second.path.read_bytes() == BODY
    assert copies(cache) == ["a"]


@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_download_is_never_used(web: WebServer, cache: Path, sign: int) -> None:
    """After Ctrl-C it is removed at once, after a kill when it is a day old."""
    url = web.add("/slow", BODY * 10, stall_after=200_000)
    process = start(url)
    while not list(cache.glob("*.part/slow")):
        assert process.poll() is None
        time.sleep(0.01)
    process.send_signal(sign)
    process.communicate(timeout=60)
    assert process.returncode != 0
    left = list(cache.glob("*.part"))
    assert bool(left) == (sign == signal.SIGKILL)
    use(web.add("/other", BODY))
    assert copies(cache) == (["other", "slow"] if left else ["other"])
    for path in (*cache.glob("*.part/slow"), *left):
        os.utime(path, (time.time() - 90_000,) * 2)
    use(web.add("/third", BODY))
    assert copies(cache) == ["other", "third"]


def test_a_full_disk_is_reported_before_the_download(
    web: WebServer, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unused logs are removed first."""
    old = web.add("/old", BODY)
    use(old)

    def usage(_: object) -> SimpleNamespace:
        return SimpleNamespace(free=(1 << 24) + (200_000 if copies(cache) else 300_000))

    monkeypatch.setattr(shutil, "disk_usage", usage)
    new = identify(web.add("/new", BODY * 2 + BODY[: len(BODY) // 2]))
    with fetched(new) as copy:
        assert copy.path.stat().st_size == new.size
    assert copies(cache) == ["new"]
    url = web.add("/newer", BODY * 4)
    message = (
        r"no space for a remote log of 0\.00041 GB: 0\.0171 GB are free; free some space, or set IMUCAL_CACHE"
    )
    with pytest.raises(ReadError, match=message) as error:
        imucal.read(url)
    assert error.value.exit_code == 3


def test_a_disk_that_fills_during_the_download_is_reported(web: WebServer, cache: Path) -> None:
    """A limit of file sizes simulates the full disk."""
    limited = (
        "import resource, signal; signal.signal(signal.SIGXFSZ, signal.SIG_IGN);"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))\n"
        "import imucal, sys\n"
        "try: imucal.read(sys.argv[1])\n"
        "except imucal.ImucalError as error: print(error)\n"
    )
    url = web.add("/a", BODY)
    out, err = start(f"{url}?sig=SECRET", limited).communicate(timeout=60)
    assert err == ""
    hint = "free some space, or set IMUCAL_CACHE to a folder on another disk"
    assert out == f"{url}: can't write a copy: File too large; {hint}\n"
    assert list(cache.iterdir()) == []


def test_the_environment_sets_folder_and_size_of_the_cache(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The default is the cache folder of the user."""
    assert cache_folder() == cache
    monkeypatch.delenv("IMUCAL_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    assert cache_folder() == tmp_path / "xdg" / "imucal"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.delenv("LOCALAPPDATA", raising=False)
    assert cache_folder() == tmp_path / ".cache" / "imucal"
    assert cache_size() == 10 << 30
    monkeypatch.setenv("IMUCAL_CACHE_SIZE", "2G")
    assert cache_size() == 2 << 30
    monkeypatch.setenv("IMUCAL_CACHE_SIZE", "much")
    with pytest.raises(imucal.ImucalError, match="IMUCAL_CACHE_SIZE: found 'much'") as error:
        cache_size()
    assert error.value.exit_code == 2
    (tmp_path / "file").write_text("", encoding="utf-8")
    monkeypatch.setenv("IMUCAL_CACHE", str(tmp_path / "file"))
    message = (
        "file: the cache of remote logs can't be used: File exists; set IMUCAL_CACHE to a folder that you own"
    )
    with pytest.raises(ReadError, match=message):
        cache_folder()
