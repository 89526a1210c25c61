"""A fleet of logs behind URLs: results, secrets, and files left on this machine."""

from pathlib import Path
from typing import Any

import pytest

from imucal.fleet.identity import identity_of
from imucal.fleet.store import read_store
from tests.cli.run import run
from tests.remote.one_axis import OPTIONS, one_axis
from tests.remote.web_server import WebServer

HOW = (*OPTIONS, "--model", "N", "--shard", "1/1")
LABELS = ("--labels", "{model}/{unit}/*.csv")
pytestmark = pytest.mark.usefixtures("logs_are_done_here", "pictures_are_blank", "cache", "no_waits")


@pytest.mark.slow
def test_a_fleet_in_a_bucket_is_processed(bucket: Any, tmp_path: Path, cache: Path) -> None:  # noqa: ANN401
    """Wildcards select the logs, keys give the labels, and copies are deleted after use.

    A second run does nothing; a new object is processed.
    """
    for seed, unit in enumerate(("u1", "u2")):
        bucket.pipe_file(f"logs/mems/{unit}/still.csv", one_axis(seed))
    logs = "s3://logs/mems/*/still.csv"
    done = run("fleet", "run", logs, *LABELS, *HOW, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert [(row["model"], row["unit"], row["path"]) for row in read_store(tmp_path / "fleet").logs()] == [
        ("mems", unit, f"s3://logs/mems/{unit}/still.csv") for unit in ("u1", "u2")
    ]
    assert list(cache.iterdir()) == []
    again = run("fleet", "run", logs, *LABELS, *HOW, cwd=tmp_path)
    assert again.stderr.startswith("0 logs to do, 0 kB; 2 already done\n")
    bucket.pipe_file("logs/mems/u2/still.csv", one_axis(9))
    bucket.pipe_file("logs/mems/u4/still.csv", one_axis(0))
    third = run("fleet", "run", logs, *LABELS, *HOW, cwd=tmp_path)
    assert third.returncode == 0, third.stderr
    # The log of the fourth unit equals the first one, byte for byte.
    assert third.stderr.startswith("1 log to do, 26.73 kB; ")
    same = "s3://logs/mems/u4/still.csv: same content as s3://logs/mems/u1/still.csv"
    assert same in third.stderr


def test_signed_urls_of_a_list_leave_no_query(web: WebServer, tmp_path: Path) -> None:
    """Queries are not stored and do not distinguish logs. A missing log is a failure."""
    urls = [web.add(f"/{name}.csv", one_axis(seed)) for seed, name in enumerate("ab")]
    urls.append(f"{web.url}/none.csv")
    text = "\n".join(f"{url}?sig=SECRET" for url in urls)
    done = run("fleet", "run", "-", *HOW, "--max-failed", "50%", cwd=tmp_path, text=text)
    assert done.returncode == 0, done.stderr
    store = read_store(tmp_path / "fleet")
    assert sorted(store.asked) == sorted(urls)
    assert [(row["status"], row["reason"]) for row in store.logs()] == [
        *[("ok", "")] * 2,
        ("unreadable", "there is no such object (404); check the address"),
    ]
    outputs = [done.stdout, done.stderr]
    outputs += [path.read_text("latin-1") for path in (tmp_path / "fleet").rglob("*") if path.is_file()]
    assert not any("SECRET" in text for text in outputs)
    twice = run("fleet", "run", f"{urls[0]}?id=1", f"{urls[0]}?id=2", *HOW, cwd=tmp_path)
    assert (twice.returncode, "differ only after the question mark" in twice.stderr) == (2, True)


def test_a_manifest_can_contain_urls(web: WebServer, tmp_path: Path) -> None:
    """The stored URLs have no queries."""
    url = web.add("/a.csv", one_axis())
    (tmp_path / "units.csv").write_text(f"path,unit\n{url}?sig=SECRET,u7\n", encoding="utf-8")
    done = run("fleet", "run", "--manifest", "units.csv", *HOW, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (row,) = read_store(tmp_path / "fleet").logs()
    assert (row["path"], row["unit"]) == (url, "u7")


def test_a_remote_log_is_identified_without_reading_it(web: WebServer) -> None:
    """By its ETag and size; a server without an ETag is asked for both ends."""
    body = one_axis() * 9
    first, same, other = (web.add(f"/{tag}{n}.csv", body, etag=tag) for n, tag in enumerate("aab"))
    longer = web.add("/longer.csv", body + b"1", etag="a")
    assert identity_of(first) == identity_of(same)
    assert len({identity_of(url) for url in (first, other, longer)}) == 3
    assert not [part for part in web.parts if part != "bytes=0-0"]


def test_a_remote_log_without_an_etag_has_the_identity_of_its_file(web: WebServer, tmp_path: Path) -> None:
    """A local log and its remote copy are equal."""
    body = one_axis() * 9
    (tmp_path / "a.csv").write_bytes(body)
    url = web.add("/a.csv", body, etag=None)
    found = identity_of(url)
    assert found == identity_of(str(tmp_path / "a.csv"))
    assert found is not None
    assert found.size == len(body)
    assert {"bytes=0-65535", f"bytes={len(body) - 65536}-{len(body) - 1}"} <= set(web.parts)
    assert identity_of(f"{web.url}/none.csv") is None
