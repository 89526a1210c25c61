"""A fleet of logs behind URLs: results, secrets, and files left on this machine."""

from pathlib import Path
from typing import Any

import pytest

from imucal.fleet.store import FleetStore
from imucal.fleet_run.logs import content_at, edge_at
from imucal.remote.stores import identify
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
    store = FleetStore(tmp_path / "fleet")
    results = store.results()
    assert set(zip(results["model"], results["unit"], results["path"], strict=True)) == {
        ("mems", unit, f"s3://logs/mems/{unit}/still.csv") for unit in ("u1", "u2")
    }
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
    store = FleetStore(tmp_path / "fleet")
    assert sorted(store.manifest()["path"]) == sorted(urls)
    logs = store.logs()
    assert sorted(logs["status"]) == ["ok", "ok", "unreadable"]
    reasons = [reason for reason in logs["reason"] if reason]
    assert reasons == ["there is no such object (404); check the address"]
    outputs = [
        done.stdout,
        done.stderr,
        *(str(frame.rows()) for frame in (store.manifest(), logs, store.results())),
    ]
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
    results = FleetStore(tmp_path / "fleet").results()
    assert (results["path"][0], results["unit"][0]) == (url, "u7")


def test_a_remote_log_has_the_checksums_of_its_file(web: WebServer, tmp_path: Path) -> None:
    """A local log and its remote copy must be recognised as equal."""
    body = one_axis() * 9
    (tmp_path / "a.csv").write_bytes(body)
    url = web.add("/a.csv", body)
    assert edge_at(url) == edge_at(str(tmp_path / "a.csv"))
    assert web.parts == ["bytes=0-65535", f"bytes={len(body) - 65536}-{len(body) - 1}"]
    assert content_at(url) == content_at(str(tmp_path / "a.csv"))
    assert identify(url).size == len(body)
