"""Tests of the store of a fleet: damaged parts, unique keys and labels."""

import multiprocessing
import re
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from imucal.errors import ReadError, StoreError, WriteError
from imucal.fleet.store import LOGS, MANIFEST, RESULTS, FleetStore


def manifest(*rows: dict[str, Any]) -> pl.DataFrame:
    """Return rows as a manifest; missing cells are null."""
    free = {name for row in rows for name in row} - set(MANIFEST)
    schema = {**MANIFEST, **dict.fromkeys(sorted(free), pl.String())}
    return pl.DataFrame([[row.get(name) for name in schema] for row in rows], schema=schema, orient="row")


def log(name: str, **more: Any) -> dict[str, Any]:  # noqa: ANN401 - values of any column
    """Return the commit record of a successful log."""
    row = {
        "key": f"key-{name}",
        "path": f"{name}.mcap",
        "status": "ok",
        "finished": 1.0,
        "findings": ["gaps"],
    }
    return {**row, **more}


def result(name: str, value: float | None = 1e-4, **more: Any) -> dict[str, Any]:  # noqa: ANN401
    """Return a log's gyro_x N."""
    row = {"key": f"key-{name}", "sensor": "gyroscope", "axis": "x", "term": "N", "value": value}
    return {**row, "low": 0.0, "high": 2e-4, "level": 0.95, **more}


def bin_row(name: str) -> dict[str, Any]:
    """Return a log's bins."""
    return {"key": f"key-{name}", "sensor": "gyroscope", "axis": "x", "bins": name.encode()}


def fleet(folder: Path, *names: str) -> FleetStore:
    """Return a store with a separate commit of each log."""
    store = FleetStore(folder / "fleet")
    store.create()
    store.add_to_manifest(manifest(*({"path": f"{name}.mcap"} for name in names)))
    for name in names:
        store.commit([log(name)], [result(name)], [bin_row(name)])
    return store


def test_committed_rows_are_read_back(tmp_path: Path) -> None:
    """All columns are equal, and missing values are null."""
    store = fleet(tmp_path, "a", "b")
    store.commit([log("c", status="unreadable", reason="no such file", findings=[])])
    logs = store.logs()
    assert logs.columns == [*LOGS, "part"]
    assert logs["path"].to_list() == ["a.mcap", "b.mcap", "c.mcap"]
    assert logs["findings"].to_list() == [["gaps"], ["gaps"], []]
    assert store.results()["value"].to_list() == [1e-4, 1e-4]
    assert store.bins()["bins"].to_list() == [b"a", b"b"]
    assert store.damaged() == {}
    store.refuse_damage()


def test_a_new_store_is_empty(tmp_path: Path) -> None:
    """Before the first part, the tables have no rows."""
    store = fleet(tmp_path)
    assert store.logs().is_empty()
    assert store.results().is_empty()
    assert store.bins().is_empty()


def test_results_without_their_commit_record_do_not_count(tmp_path: Path) -> None:
    """A process that was killed between the parts has not finished its logs."""
    store = fleet(tmp_path, "a", "b")
    part = store.logs().filter(pl.col("key") == "key-a")["part"].item()
    (store.folder / "logs" / part).unlink()
    assert store.logs()["key"].to_list() == ["key-b"]
    assert store.results()["key"].to_list() == ["key-b"]
    assert store.bins()["key"].to_list() == ["key-b"]


@pytest.mark.parametrize("table", ["bins", "results", "logs"])
@pytest.mark.parametrize("keep", [0.0, 0.02, 0.5, 0.99])
def test_a_truncated_part_is_rejected_until_it_is_repaired(tmp_path: Path, table: str, keep: float) -> None:
    """The repair removes the three parts of the log, so the next run repeats it."""
    store = fleet(tmp_path, "a", "b")
    part = store.folder / table / store.logs().filter(pl.col("key") == "key-a")["part"].item()
    data = part.read_bytes()
    part.write_bytes(data[: int(keep * len(data))])
    message = re.escape(f"{part}: is damaged; run the fleet again to repeat its logs")
    with pytest.raises(StoreError, match=f"^{message}"):
        store.refuse_damage()
    assert store.mend() == [part]
    store.refuse_damage()
    assert store.logs()["key"].to_list() == ["key-b"]
    assert store.results()["key"].to_list() == ["key-b"]
    store.commit([log("a")], [result("a", 3e-4)], [bin_row("a")])
    assert store.results()["value"].to_list() == [3e-4, 1e-4]


def test_a_missing_part_counts_as_damaged(tmp_path: Path) -> None:
    """A log without its results is not done."""
    store = fleet(tmp_path, "a", "b")
    part = store.logs().filter(pl.col("key") == "key-a")["part"].item()
    (store.folder / "results" / part).unlink()
    assert store.mend() == [store.folder / "results" / part]
    assert store.logs()["key"].to_list() == ["key-b"]


def test_a_part_with_other_columns_counts_as_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another version may lack a column, which must not be read as missing numbers."""
    store = fleet(tmp_path, "a")
    monkeypatch.setitem(RESULTS, "later", pl.Float64())
    with pytest.raises(StoreError, match=r"results/part-.*: is damaged"):
        store.refuse_damage()


def test_other_programs_can_read_the_parts(tmp_path: Path) -> None:
    """The checksum is in metadata that Parquet allows."""
    store = fleet(tmp_path, "a")
    for part in store.folder.rglob("*.parquet"):
        assert pl.read_parquet(part).height == pl.scan_parquet(part).collect().height == 1


def test_derived_results_are_stored_by_key(tmp_path: Path) -> None:
    """Only requested keys are returned, and only a damaged part of them is removed."""
    store = fleet(tmp_path, "a")
    assert store.derived(["x"]) == {}
    store.keep_derived({"x": "1", "y": "2"})
    store.keep_derived({"z": "3"})
    assert store.derived(["x", "z", "w"]) == {"x": "1", "z": "3"}
    for part in (store.folder / "derived").iterdir():
        part.write_bytes(part.read_bytes()[:-1])
    assert len(store.mend()) == 2
    assert store.derived(["x"]) == {}
    assert store.logs().height == 1


def test_a_repeated_key_counts_once(tmp_path: Path) -> None:
    """The newest success counts, even if a failure follows."""
    store = fleet(tmp_path, "a")
    store.commit([log("a", finished=3.0)], [result("a", 3e-4)], [bin_row("a")])
    store.commit([log("a", finished=2.0)], [result("a", 2e-4)], [bin_row("a")])
    store.commit([log("a", finished=4.0, status="memory")])
    assert store.logs()["finished"].to_list() == [3.0]
    assert store.results()["value"].to_list() == [3e-4]
    assert store.bins().height == 1


def test_a_path_with_new_content_counts_once(tmp_path: Path) -> None:
    """The newest content counts."""
    store = fleet(tmp_path, "a")
    store.commit([log("a", key="key-new", finished=2.0)], [result("a", 5e-4, key="key-new")])
    assert store.logs()["key"].to_list() == ["key-new"]
    assert store.results()["value"].to_list() == [5e-4]


def test_the_manifest_overrides_labels(tmp_path: Path) -> None:
    """A corrected label does not require another run; labels that only the log has are kept."""
    store = fleet(tmp_path, "a", "b")
    started = "2026-01-02T12:00:00Z"
    store.commit([log("b", finished=2.0, unit="old", started=started)], [result("b")], [bin_row("b")])
    store.add_to_manifest(
        manifest(
            {"path": "a.mcap", "model": "m", "unit": "7", "temperature_c": 25.0, "started": "1970-01-03"},
            {"path": "b.mcap", "model": "m", "unit": "8", "note": "odd"},
        )
    )
    assert store.logs()["unit"].to_list() == ["7", "8"]
    assert store.results()["unit"].to_list() == ["7", "8"]
    assert store.logs()["temperature_c"].to_list() == [25.0, None]
    assert store.logs()["started"].to_list() == ["1970-01-03", started]
    assert store.manifest()["note"].to_list() == [None, "odd"]


def test_a_moved_log_keeps_its_result_and_gets_new_labels(tmp_path: Path) -> None:
    """The manifest contains the path of the original."""
    store = fleet(tmp_path, "a")
    store.add_to_manifest(manifest({"path": "new/a.mcap", "unit": "7", "copy_of": "a.mcap"}))
    assert store.logs()["unit"].to_list() == [None]
    store.clear()
    store.add_to_manifest(manifest({"path": "new/a.mcap", "unit": "7", "copy_of": "a.mcap"}))
    store.commit([log("a")], [result("a")], [bin_row("a")])
    assert store.results()["unit"].to_list() == ["7"]


def test_a_folder_without_a_fleet_is_rejected(tmp_path: Path) -> None:
    """The error contains advice, and the folder is not changed."""
    store = FleetStore(tmp_path)
    (tmp_path / "thesis.tex").write_text("x")
    with pytest.raises(WriteError, match=r"contains thesis\.tex"):
        store.create()
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]
    with pytest.raises(ReadError, match=r"manifest\.parquet: no such file"):
        store.manifest()
    (tmp_path / "manifest.parquet").write_text("none")
    with pytest.raises(StoreError, match=r"manifest\.parquet: is damaged"):
        store.manifest()


def test_a_folder_that_cannot_be_created_is_an_error(tmp_path: Path) -> None:
    """A file has the name of its parent."""
    (tmp_path / "file").write_text("x")
    with pytest.raises(WriteError, match=r"file/fleet: .*Not a directory"):
        FleetStore(tmp_path / "file" / "fleet").create()


def _add(folder: Path, names: list[str]) -> None:
    store = FleetStore(folder)
    for name in names:
        store.add_to_manifest(manifest({"path": name}))
        store.commit([log(name)], [result(name)], [bin_row(name)], shard=name)


def test_two_processes_can_write_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """No row of the manifest and no log is lost."""
    # The new processes import this module from there.
    monkeypatch.syspath_prepend(Path(__file__).parents[2])
    store = fleet(tmp_path)
    context = multiprocessing.get_context("spawn")
    names = [[f"{shard}{i}" for i in range(15)] for shard in "ab"]
    writers = [context.Process(target=_add, args=(store.folder, own)) for own in names]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert sorted(store.manifest()["path"]) == sorted([*names[0], *names[1]])
    assert store.logs().height == store.results().height == 30


def test_clearing_a_store_removes_everything(tmp_path: Path) -> None:
    """It removes parts, manifest and reports of logs."""
    store = fleet(tmp_path, "a")
    (store.folder / "reports" / "x").mkdir(parents=True)
    store.clear()
    assert not store.exists
    assert store.logs().is_empty()
    assert not (store.folder / "reports").exists()


def test_bins_are_read_by_groups(tmp_path: Path) -> None:
    """Groups contain the bins of their logs from all parts; together they equal a complete read."""
    store = fleet(tmp_path, "a", "b", "c")
    store.commit([log("d"), log("e")], [], [bin_row("d"), bin_row("e")])
    # The log is repeated; only the newest bins count.
    store.commit([log("a", finished=2.0)], [], [{**bin_row("a"), "bins": b"again"}])
    groups = [["key-e", "key-a"], [], ["key-b", "key-unknown"], ["key-c", "key-d"]]
    frames = [store.bins(keys) for keys in groups]
    assert [frame["bins"].to_list() for frame in frames] == [[b"again", b"e"], [], [b"b"], [b"c", b"d"]]
    assert pl.concat(frames).sort("key").equals(store.bins())


def test_a_folder_in_place_of_a_part_counts_as_damaged(tmp_path: Path) -> None:
    """The next run removes it and repeats the logs of the batch."""
    store = fleet(tmp_path, "a", "b")
    part = next((store.folder / "results").glob("part-*.parquet"))
    part.unlink()
    part.mkdir()
    (part / "file").write_text("", encoding="utf-8")
    with pytest.raises(StoreError, match="is damaged"):
        store.refuse_damage()
    assert store.mend() == [part]
    assert not part.exists()
    store.refuse_damage()
