"""Tests of the plan of a fleet: finished logs are skipped, and every content is done once."""

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from imucal.fleet.identity import identity_of
from imucal.fleet.logs import LogTask
from imucal.fleet.plan import FleetPlan, FleetSettings, plan_fleet
from imucal.fleet.running import run_file
from imucal.fleet.store import is_fleet, read_store
from imucal.fleet.work import first_row


@pytest.fixture
def settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> FleetSettings:
    """Return the settings of a store in an empty working folder."""
    monkeypatch.chdir(tmp_path)
    return FleetSettings(store=str(tmp_path / "fleet"), folder=str(tmp_path), memory=1 << 30)


def plan(settings: FleetSettings, *paths: str, **reading: object) -> FleetPlan:
    """Return the plan of some logs."""
    stored = read_store(settings.store) if is_fleet(settings.store) else None
    return plan_fleet([LogTask(place=p) for p in paths], replace(settings, reading=reading), stored)


def copies(made: FleetPlan) -> dict[str, str]:
    """Return the copied logs with their originals."""
    return {log.path: log.copy_of for log in made.logs if log.copy_of}


def finish(settings: FleetSettings, made: FleetPlan, status: str = "ok") -> None:
    """Store all tasks of a plan with this status, without work."""
    file = run_file(made, settings)
    assert file is not None
    with file:
        for task in made.tasks:
            row = first_row(task, settings, status=status)
            if identity := identity_of(task.place):
                row |= {"identity": identity.digest, "key": settings.key(identity.digest, task.reading)}
            file.add(row)


def paths(tasks: Sequence[LogTask]) -> list[str]:
    """Return the paths of tasks."""
    return [task.path for task in tasks]


def write(**contents: str) -> None:
    """Write files."""
    for name, text in contents.items():
        Path(name).write_text(text)


def test_finished_logs_are_skipped(settings: FleetSettings) -> None:
    """A changed file, changed settings and changed arguments of reading are new work; a new date is not."""
    write(a="aaa", b="bb")
    finish(settings, plan(settings, "a", "b"))
    os.utime("a", (1, 1))
    again = plan(settings, "a", "b")
    assert (again.tasks, paths(again.own("done"))) == ([], ["a", "b"])
    assert run_file(again, settings) is None
    assert paths(plan(settings, "a", "b", rate_hz=100.0).tasks) == ["a", "b"]
    assert paths(plan(replace(settings, model="N + K"), "a", "b").tasks) == ["a", "b"]
    assert paths(plan(replace(settings, level=0.9), "a", "b").tasks) == ["a", "b"]
    write(a="aax")
    changed = plan(settings, "a", "b")
    assert (paths(changed.tasks), changed.tasks[0].state) == (["a"], "run")


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
    assert paths(plan(settings, "a", "b").tasks) == (["a", "b"] if again else ["b"])


def test_a_log_that_could_not_be_opened_is_tried_again(settings: FleetSettings) -> None:
    """Its content is unknown."""
    finish(settings, plan(settings, "a"), "unreadable")
    assert paths(plan(settings, "a").own("again")) == ["a"]


def test_equal_contents_are_done_once(settings: FleetSettings) -> None:
    """The first log counts. A shard has its own logs, and every shard stores all requests."""
    write(a="same", b="size", c="same")
    found = plan(settings, "a", "b", "c", "missing", "gone")
    assert paths(found.tasks) == ["a", "b", "missing", "gone"]
    assert copies(found) == {"c": "a"}
    assert [row.copy_of for row in found.asked()] == [None, None, "a", None, None]
    second = plan(replace(settings, shard=(2, 2)), "a", "b", "c", "missing", "gone")
    assert paths(second.own()) == ["b", "missing"]
    assert second.asked() == found.asked()
    finish(settings, found)
    assert plan(settings, "a", "b", "c").asked() == []


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
    found = plan_fleet([LogTask(place="a"), LogTask(place="b", reading={"rate_hz": 2.0})], settings)
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

    def compare(log: LogTask, other: object) -> bool:
        pytest.fail(f"{log} was compared with {other}")

    monkeypatch.setattr(LogTask, "__eq__", compare)
    names = [f"{number}.mcap" for number in range(1000)]
    part = plan(replace(settings, shard=(2, 2)), *names)
    assert paths(part.own()) == paths(part.tasks) == names[1::2]
