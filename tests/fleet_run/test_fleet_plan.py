"""Tests of the plan of a fleet: finished logs are skipped, and every content is done once."""

import os
import threading
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from imucal.fleet.store import FleetStore
from imucal.fleet_run import FleetPlan, FleetSettings, LogTask
from imucal.fleet_run.log_work import commit, first_row
from imucal.fleet_run.logs import content_at, edge_at, stamps_of
from imucal.fleet_run.plan import batches, plan_fleet


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FleetSettings:
    """Return the settings of a store in an empty working folder."""
    monkeypatch.chdir(tmp_path)
    return FleetSettings(store=str(tmp_path / "fleet"), folder=str(tmp_path), memory=1 << 30)


def plan(settings: FleetSettings, *paths: str, **reading: object) -> FleetPlan:
    """Return the plan of some logs."""
    return plan_fleet([LogTask(place=p) for p in paths], replace(settings, reading=reading))


def copies(made: FleetPlan) -> dict[str, str]:
    """Return the copied logs with their originals."""
    return {log.path: log.copy_of for log in made.logs if log.copy_of}


def finish(settings: FleetSettings, made: FleetPlan, status: str = "ok") -> None:
    """Commit all tasks of a plan with this status, without work."""
    store = FleetStore(settings.store)
    store.create()
    store.add_to_manifest(made.manifest())
    rows = []
    for task in made.tasks:
        path = task.path
        stamp = stamps_of({path: path})[path]
        assert stamp is not None
        known = {"content": content_at(path), "edge": edge_at(path), "mtime_ns": stamp.mtime_ns}
        key = settings.key(known["content"], task.reading)  # type: ignore[arg-type] # a text
        rows.append({**first_row(task, settings, status=status), **known, "key": key})
    commit(rows, settings)


def paths(tasks: Sequence[LogTask]) -> list[str]:
    """Return the paths of tasks."""
    return [task.path for task in tasks]


def write(**contents: str) -> None:
    """Write files."""
    for name, text in contents.items():
        Path(name).write_text(text)


def test_finished_logs_are_skipped(settings: FleetSettings) -> None:
    """A changed file, changed settings and changed reading options are new work."""
    write(a="aaa", b="bb")
    finish(settings, plan(settings, "a", "b"))
    again = plan(settings, "a", "b")
    assert (again.tasks, paths(again.own("done"))) == ([], ["a", "b"])
    assert paths(plan(settings, "a", "b", rate_hz=100.0).tasks) == ["a", "b"]
    assert paths(plan(replace(settings, model="N + K"), "a", "b").tasks) == ["a", "b"]
    assert paths(plan(replace(settings, level=0.9), "a", "b").tasks) == ["a", "b"]
    write(a="aax")
    os.utime("a", (1, 1))
    assert paths(plan(settings, "a", "b").tasks) == ["a"]


@pytest.mark.parametrize(
    ("status", "again"),
    [("ok", False), ("unreadable", False), ("no-data", False)]
    + [(status, True) for status in ("memory", "timeout", "crash")],
)
def test_failures_of_the_machine_are_tried_again(
    settings: FleetSettings, status: str, *, again: bool
) -> None:
    """Timeouts, missing memory and crashes may not be caused by the log."""
    write(a="aaa")
    finish(settings, plan(settings, "a"), status)
    found = plan(settings, "a")
    assert paths(found.tasks) == paths(found.own("again")) == (["a"] if again else [])
    # The tasks are in the order of the logs, whatever their status.
    write(b="bb")
    assert paths(plan(settings, "a", "b").tasks) == (["a", "b"] if again else ["b"])


def test_a_log_that_could_not_be_opened_is_tried_again(settings: FleetSettings) -> None:
    """Its content is unknown."""
    store = FleetStore(settings.store)
    store.create()
    store.add_to_manifest(plan(settings, "a").manifest())
    commit([first_row(LogTask(place="a"), settings, status="unreadable", reason="no such file")], settings)
    assert paths(plan(settings, "a").own("again")) == ["a"]


def test_equal_contents_are_done_once(settings: FleetSettings) -> None:
    """The first log counts; equal sizes or equal edges are not equal contents."""
    edge = "e" * (1 << 16)
    write(a="same", b="size", c="same", d=edge + "x" + edge, e=edge + "y" + edge)
    found = plan(settings, "a", "b", "c", "d", "e")
    assert paths(found.tasks) == ["a", "b", "d", "e"]
    assert copies(found) == {"c": "a"}
    assert found.manifest()["copy_of"].to_list() == [None, None, "a", None, None]
    # A shard contains its own logs, and the manifest contains all logs.
    second = plan(replace(settings, shard=(2, 2)), "a", "b", "c", "d", "e")
    assert paths(second.own()) == ["b", "d"]
    assert second.manifest().equals(found.manifest())


def test_a_moved_log_is_recognised_by_its_content(settings: FleetSettings) -> None:
    """The old log may still exist, in any order."""
    write(a="same", other="else")
    finish(settings, plan(settings, "a"))
    Path("a").rename("b")
    moved = plan(settings, "b", "other")
    assert (paths(moved.tasks), paths(moved.own("done")), copies(moved)) == (["other"], ["b"], {"b": "a"})
    write(a="same")
    both = plan(settings, "b", "a")
    assert (both.tasks, copies(both)) == ([], {"b": "a"})


def test_equal_contents_with_different_options_are_two_results(settings: FleetSettings) -> None:
    """A key depends on content and settings."""
    write(a="same", b="same")
    entries = [LogTask(place="a"), LogTask(place="b", reading={"rate_hz": 2.0})]
    found = plan_fleet(entries, settings)
    assert (paths(found.tasks), copies(found)) == (["a", "b"], {})


def test_the_content_of_a_bag_is_that_of_all_its_files(settings: FleetSettings) -> None:
    """The names of the files do not matter."""
    for name, text in (("one", "x"), ("two", "x"), ("three", "y")):
        Path(name).mkdir()
        write(**{f"{name}/metadata.yaml": "m", f"{name}/{name}_0.db3": text})
    found = plan(settings, "one", "two", "three")
    assert (paths(found.tasks), copies(found)) == (["one", "three"], {"two": "one"})
    assert found.tasks[0].size == 2


def test_shards_contain_every_log_once_whenever_they_start(settings: FleetSettings) -> None:
    """The division does not depend on finished logs."""
    names = [f"log{i}" for i in range(10)]
    write(**{name: name * (i + 1) for i, name in enumerate(names)})
    first, *others = (replace(settings, shard=(number, 3)) for number in (1, 2, 3))
    part = plan(first, *names)
    assert paths(part.own()) == paths(part.tasks) == names[::3]
    finish(settings, part)
    later = [plan(other, *names) for other in others]
    assert sorted(path for one in (part, *later) for path in paths(one.tasks)) == sorted(names)


def test_a_plan_does_not_compare_pairs_of_logs(
    settings: FleetSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For 100 000 logs a comparison of all pairs takes more than a minute."""
    names = [f"{number}.mcap" for number in range(1000)]
    shown_paths = []

    def shown(place: str) -> str:
        shown_paths.append(place)
        return place

    def compare(log: LogTask, other: object) -> bool:
        pytest.fail(f"{log} was compared with {other}")

    monkeypatch.setattr("imucal.fleet_run.plan.shown", shown)
    monkeypatch.setattr(LogTask, "__eq__", compare)
    part = plan(replace(settings, shard=(2, 2)), *names)
    # Each path is the key of a few tables.
    assert len(shown_paths) <= 5 * len(names)
    assert paths(part.own()) == paths(part.tasks) == names[1::2]


def test_the_checksum_does_not_depend_on_the_size_of_reads(tmp_path: Path) -> None:
    """A network file system may return less than requested."""

    def checksum(pieces: list[bytes]) -> str:
        pipe = tmp_path / f"pipe{len(pieces)}"
        os.mkfifo(pipe)

        def write_pieces() -> None:
            with pipe.open("wb", buffering=0) as stream:
                for piece in pieces:
                    stream.write(piece)

        writer = threading.Thread(target=write_pieces)
        writer.start()
        found = content_at(str(pipe))
        writer.join()
        return found

    data = bytes(range(256)) * 8192
    assert checksum([data]) == checksum([data[at : at + 7000] for at in range(0, len(data), 7000)])


@pytest.mark.parametrize(("workers", "seconds"), [(2, 30.0), (50, 30.0), (1, 0.0), (3, 1e9)])
def test_batches_contain_every_task_once(workers: int, seconds: float) -> None:
    """A batch takes about the requested time, or less so that every worker has some."""
    tasks = [LogTask(place=str(i), size=i * 10**6) for i in range(100)]
    made = list(batches(tasks, workers=workers, seconds=seconds))
    assert [task for batch in made for task in batch] == tasks
    longest = max(sum(task.seconds for task in batch[:-1]) for batch in made)
    assert longest < max(seconds, 1e-9)
    assert len(made) >= min(2 * workers, 90)


def test_a_long_run_has_longer_batches() -> None:
    """Every batch is a part of the store: 1e5 logs of 6 s on eight workers are 2 000 parts, not 20 000."""
    tasks = [LogTask(place=f"{number}.mcap", size=85_000_000) for number in range(100_000)]
    sizes = [len(batch) for batch in batches(tasks, workers=8, seconds=30.0)]
    assert sum(sizes) == len(tasks)
    assert set(sizes[:-1]) == {50}
    few = [len(batch) for batch in batches(tasks[:200], workers=8, seconds=30.0)]
    assert set(few) == {5}


def test_no_tasks_have_no_batches() -> None:
    assert list(batches([], workers=2, seconds=30.0)) == []
