"""Faults of a fleet run and their expected results: no lost or repeated log, exit codes, equal results.

Each scenario takes a bench whose folder contains ``logs`` and the store ``whole`` of an undisturbed run. It
returns a line that describes the result; assertions check the result.
"""

import contextlib
import gzip
import os
import resource
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import psutil
from distributed import Client

from tests.fleet_run.faults import (
    Bench,
    Ended,
    Hold,
    children_of,
    cluster,
    ended,
    hanging_log,
    huge_log,
    left_over,
    wait_until,
    workers_of,
)

HERE = ("--shard", "1/1")


def process_of_a_log_killed(bench: Bench) -> str:
    """Kill the process of a log, as the system does without memory; the log is repeated."""
    run = bench.start("child", *HERE)
    wait_until(lambda: bool(children_of(run.pid)))
    time.sleep(0.5)
    for child in children_of(run.pid):
        child.kill()
    end = ended(run)
    assert end.code == 0, end.err
    return _same(bench, "child", end)


def process_of_a_log_killed_again_and_again(bench: Bench) -> str:
    """Kill the process of a log twice: the run gives this log up and continues, and the next run does it."""
    run = bench.start("children", *HERE)
    killed = 0
    while killed < 2:
        wait_until(lambda: bool(children_of(run.pid)) or run.poll() is not None)
        for child in children_of(run.pid):
            with contextlib.suppress(psutil.NoSuchProcess):
                child.kill()
                killed += 1
        time.sleep(0.05)
    end = ended(run)
    assert end.code == 0, end.err
    assert bench.store("children").logs()["status"].to_list().count("crash") == 1
    assert "its process ended 2 times (SIGKILL)" in end.err
    return _same(bench, "children", bench.finish("children"), first=end)


def worker_killed(bench: Bench) -> str:
    """Kill a worker of a cluster within a batch; another worker does it."""
    hold = Hold(bench.folder / "held")
    with cluster(bench.folder, workers=bench.jobs, environment=hold.environment) as (address, _):
        run = bench.start("worker", "--scheduler", address)
        wait_until(lambda: bool(workers_of(bench.folder)) or run.poll() is not None)
        workers_of(bench.folder)[0].kill()
        hold.release()
        end = ended(run)
    assert end.code == 0, end.err
    return _same(bench, "worker", end)


def process_of_a_log_frozen(bench: Bench) -> str:
    """Stop the process of a log by SIGSTOP: it ends after the timeout, and the next run does the log."""
    run = bench.start("frozen", "--jobs", str(bench.jobs), "--timeout", "8s")
    wait_until(lambda: bool(children_of(run.pid)))
    children_of(run.pid)[0].suspend()
    end = ended(run)
    assert end.code == 0, end.err
    assert "it took more than 8 s; give it more time" in end.err
    return _same(bench, "frozen", bench.finish("frozen"), first=end)


def terminated(bench: Bench) -> str:
    """End a run by SIGTERM, as a queue does: no process remains, and the next run does the other logs."""
    run = bench.start("terminated", "--jobs", str(bench.jobs))
    bench.wait_for_parts("terminated", run)
    run.terminate()
    run.communicate()
    wait_until(lambda: not left_over(bench.folder))
    return _same(bench, "terminated", bench.finish("terminated"))


def log_without_end(bench: Bench) -> str:
    """Read an endless device in place of a log: it is refused at once."""
    (bench.folder / "endless").mkdir()
    hanging_log(bench.folder / "endless" / "hang.csv")
    end = bench.run("endless-store", *HERE, "--timeout", "30", logs="endless")
    assert end.code == 3, end.err
    message = "endless/hang.csv: a device; expected a regular file, copy the data to one"
    assert message in end.err, end.err
    assert bench.store("endless-store").logs()["status"].to_list() == ["unreadable"]
    return f"exit {end.code}: refused"


def log_without_measure(bench: Bench, arguments: tuple[str, ...] = HERE) -> str:
    """Read a log that needs too much memory: it is reported, and all others are done."""
    # The folder also contains two small logs.
    names = sorted(path.relative_to(bench.folder / "logs") for path in (bench.folder / "logs").rglob("*.npz"))
    for name in names[:2]:
        (bench.folder / "large" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(bench.folder / "logs" / name, bench.folder / "large" / name)
    huge_log(bench.folder / "large" / "huge.npz")
    end = bench.run("large-store", *arguments, "--memory", "310MB", logs="large")
    assert end.code == 0, end.err
    logs = bench.store("large-store").logs()
    status = dict(zip(logs["path"], logs["status"], strict=True))
    assert status.pop("large/huge.npz") == "memory", end.err
    whole = bench.store("whole").logs()
    expected = dict(zip(whole["path"], whole["status"], strict=True))
    assert status == {f"large/{name}": expected[f"logs/{name}"] for name in names[:2]}
    shutil.rmtree(bench.folder / "large")
    return f"exit {end.code}: memory, all others done"


def log_without_measure_on_a_worker(bench: Bench) -> str:
    """Read a log that needs too much memory on a cluster: no worker is lost."""
    shutil.rmtree(bench.folder / "large-store", ignore_errors=True)
    with cluster(bench.folder, workers=bench.jobs) as (address, _):
        return log_without_measure(bench, ("--scheduler", address))


def scheduler_killed(bench: Bench) -> str:
    """Kill the scheduler: the exit code is 5, and the printed command continues without a scheduler."""
    with cluster(bench.folder, workers=bench.jobs) as (address, scheduler):
        run = bench.start("scheduler", "--scheduler", address)
        bench.wait_for_parts("scheduler", run)
        scheduler.kill()
        end = ended(run)
    assert end.code == 5, end.err
    assert f"Error: {address}: scheduler or workers are gone; finished logs are kept" in end.err, end.err
    assert "Finished logs are kept; to continue: imucal fleet run logs" in end.err
    return _same(bench, "scheduler", bench.finish("scheduler"), first=end)


def interrupted(bench: Bench, arguments: tuple[str, ...] = ("--jobs", "2")) -> str:
    """Press Ctrl-C, which reaches all processes of a terminal: exit code 130, and a command to continue."""
    for _ in range(3):
        shutil.rmtree(bench.folder / "interrupted", ignore_errors=True)
        run = bench.start("interrupted", *arguments)
        bench.wait_for_parts("interrupted", run)
        begun = time.monotonic()
        os.killpg(run.pid, signal.SIGINT)
        end = ended(run)
        seconds = time.monotonic() - begun
        done, every = (bench.store(name).logs().height for name in ("interrupted", "whole"))
        # On a busy machine, the run may have ended before.
        if end.code and done < every:
            break
    assert end.code == 130, end.err
    assert "Traceback" not in end.err, end.err
    assert done < every, (done, seconds)
    wait_until(lambda: not left_over(bench.folder))
    return _same(bench, "interrupted", bench.type_again(end.err), first=end) + f" (ended in {seconds:.1f} s)"


def interrupted_in_one_process(bench: Bench) -> str:
    """Press Ctrl-C in a run without child workers."""
    return interrupted(bench, HERE)


def client_killed(bench: Bench) -> str:
    """Kill the client: no process continues, and the next run does the other logs."""
    run = bench.start("client", "--jobs", str(bench.jobs))
    bench.wait_for_parts("client", run)
    run.kill()
    run.communicate()
    wait_until(lambda: not left_over(bench.folder))
    return _same(bench, "client", bench.finish("client"), first=Ended(code=-9, out="", err=""))


def disk_full(bench: Bench, arguments: tuple[str, ...] = HERE) -> str:
    """Limit the size of files to the manifest's: exit code 5, no parts, and the next run does all logs."""
    room = 2 * (bench.folder / "whole" / "manifest.parquet").stat().st_size

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))

    end = bench.run("full", *arguments, limit=limit)
    assert end.code == 5, (end.code, end.err)
    assert "can't be written: File too large; free some space or choose another place" in end.err
    assert bench.store("full").logs().is_empty()
    return _same(bench, "full", bench.type_again(end.err), first=end)


def disk_full_for_real(bench: Bench) -> str:
    """Fill a small file system in the middle of a run; needs the right to mount."""
    disk = bench.folder / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=160k", "tmpfs", str(disk)], check=True)  # noqa: S603, S607
    try:
        end = bench.run("disk/store", "--jobs", str(bench.jobs))
        assert end.code == 5, (end.code, end.err)
        assert "No space left on device; free some space or choose another place" in end.err
        done = bench.store("disk/store").logs().height
        subprocess.run(["mount", "-o", "remount,size=64m", str(disk)], check=True)  # noqa: S603, S607
        return f"{done} logs before; " + _same(bench, "disk/store", bench.type_again(end.err), first=end)
    finally:
        subprocess.run(["umount", str(disk)], check=True)  # noqa: S603, S607


def two_runs_at_once(bench: Bench, arguments: tuple[str, ...] = HERE) -> str:
    """Start two runs on one store: both succeed, and every log counts once."""
    runs = [bench.start("both", *arguments) for _ in range(2)]
    ends = [ended(run) for run in runs]
    assert [end.code for end in ends] == [0, 0], [end.err for end in ends]
    return _same(bench, "both", ends[1], first=ends[0])


def parts_cut_off(bench: Bench) -> str:
    """Truncate parts, as a loss of power does: reports exit with 5, and the next run repeats their logs."""
    shutil.copytree(bench.folder / "whole", bench.folder / "cut")
    parts = sorted((bench.folder / "cut" / "logs").iterdir())
    tables = ("logs", "results", "bins")
    for table, part in zip(tables, parts, strict=False):
        with Path(bench.folder / "cut" / table / part.name).open("r+b") as file:
            file.truncate(file.seek(0, os.SEEK_END) * 2 // 3)
    cut = min(len(tables), len(parts))
    assert bench.type("fleet", "report", "cut").code == 5
    end = bench.finish("cut")
    assert end.err.count(": is damaged; its logs are repeated") == cut, end.err
    return f"{cut} parts; " + _same(bench, "cut", end)


def client_frozen(bench: Bench) -> str:
    """Stop the client by SIGSTOP and resume it, like a laptop that sleeps; it continues."""
    run = bench.start("asleep", "--jobs", str(bench.jobs))
    wait_until(lambda: bool(children_of(run.pid)))
    psutil.Process(run.pid).suspend()
    time.sleep(2.0)
    psutil.Process(run.pid).resume()
    return _same(bench, "asleep", ended(run))


def store_deleted(bench: Bench) -> str:
    """Delete the store during a run: exit code 5 with the missing name, and the next run does all logs."""
    run = bench.start("deleted", "--jobs", "1")
    bench.wait_for_parts("deleted", run)
    shutil.rmtree(bench.folder / "deleted")
    end = ended(run)
    assert end.code == 5, (end.code, end.err)
    assert "can't be written: No such file or directory" in end.err
    assert "Traceback" not in end.err
    return _same(bench, "deleted", bench.finish("deleted"), first=end)


def two_clients_of_a_cluster(bench: Bench) -> str:
    """Start two runs on one scheduler and one store: both succeed, and every log counts once."""
    with cluster(bench.folder, workers=bench.jobs) as (address, _):
        return two_runs_at_once(bench, ("--scheduler", address))


def another_numpy_on_a_worker(bench: Bench) -> str:
    """Use the NumPy in ``IMUCAL_OTHER_NUMPY`` on a worker: equal verdicts, and numbers equal to rounding."""
    other = os.environ.get("IMUCAL_OTHER_NUMPY")
    if other is None:
        return "no other NumPy: not done"
    paths = os.pathsep.join(filter(None, [other, os.environ.get("PYTHONPATH")]))
    with cluster(bench.folder, workers=1, environment={"PYTHONPATH": paths}) as (address, _):
        end = bench.run("numpy", "--scheduler", address)
        with Client(address) as client:
            (version,) = client.run(_numpy_version).values()
    assert end.code == 0, end.err
    here, there = bench.store("whole"), bench.store("numpy")
    columns = ("path", "key", "content", "status", "verdict", "findings")
    assert there.logs().select(columns).equals(here.logs().select(columns))
    numbers = ("value", "low", "high", "variance")
    both = [(there.results()[name].to_numpy(), here.results()[name].to_numpy()) for name in numbers]
    apart = [float(np.nanmax(np.abs(one - two) / np.nanmax(np.abs(two)))) for one, two in both]
    assert max(apart) < 1e-6, apart
    assert version != np.__version__
    return f"exit {end.code}: NumPy {version} beside {np.__version__}, numbers within {max(apart):.1g}"


def _numpy_version() -> str:
    """Return the NumPy version of a worker."""
    return np.__version__


def links(bench: Bench) -> str:
    """Add links to a log, a missing file and their own folder: each log counts once, errors are reported."""
    folder = bench.folder / "linked"
    shutil.copytree(bench.folder / "logs", folder)
    log = next(folder.rglob("*.npz"))
    (folder / "again.npz").symlink_to(log)
    (folder / "gone.npz").symlink_to("nowhere.npz")
    (folder / "round").symlink_to(folder, target_is_directory=True)
    end = bench.finish("linked-store", logs="linked")
    assert end.code == 0, end.err
    assert "linked/gone.npz: can't be opened: No such file or directory" in end.err, end.err
    manifest = bench.store("linked-store").manifest()
    assert manifest.height == bench.store("whole").logs().height + 2
    assert manifest.drop_nulls("copy_of").height == 1
    shutil.rmtree(folder)
    return f"exit {end.code}: {manifest.height} names, same results"


def bomb(bench: Bench) -> str:
    """Read 1 MB that decompresses to 1 GB: only this log is limited by memory or time."""
    (bench.folder / "bombs").mkdir()
    shutil.copy(next((bench.folder / "logs").rglob("*.npz")), bench.folder / "bombs" / "log.npz")
    with gzip.open(bench.folder / "bombs" / "bomb.csv.gz", "wb", compresslevel=9) as file:
        file.write(b"t,gx,gy,gz,ax,ay,az\n")
        for _ in range(1024):
            file.write(b"1.25,0.0,0.0,0.0,0.0,0.0,9.8012\n" * (1 << 15))
    end = bench.run("bomb-store", *HERE, "--memory", "400MB", "--timeout", "60s", logs="bombs")
    assert end.code == 0, end.err
    logs = bench.store("bomb-store").logs()
    status = dict(logs.select("path", "status").iter_rows())
    assert status["bombs/log.npz"] == "ok"
    assert status["bombs/bomb.csv.gz"] in {"unreadable", "memory", "timeout"}
    seconds = float(logs.filter(path="bombs/bomb.csv.gz")["wall_s"].sum() or 0.0)
    shutil.rmtree(bench.folder / "bombs")
    return f"exit {end.code}: {status['bombs/bomb.csv.gz']} after {seconds:.0f} s, all others done"


def private_umask_and_closed_output(bench: Bench) -> str:
    """Use umask 077: other users cannot read the files; with 022, as in the undisturbed run, they can.

    Standard output is closed, as for a service, and the run still completes.
    """

    def limit() -> None:
        os.umask(0o077)
        os.close(1)

    end = bench.run("private", *HERE, limit=limit)
    assert "Traceback" not in end.err, end.err
    for name, mode in (("private", 0), ("whole", 0o044)):
        files = [path for path in (bench.folder / name).rglob("*") if path.name != ".lock"]
        assert {path.stat().st_mode & 0o066 for path in files if path.is_file()} == {mode}
        assert {path.stat().st_mode & 0o022 for path in files} == {0}
    return _same(bench, "private", end)


def _same(bench: Bench, name: str, last: Ended, *, first: Ended | None = None) -> str:
    """Return a summary after checking that a store has every log once, with the undisturbed results."""
    assert last.code == 0, last.err
    differences = bench.differences(name, "whole")
    statuses = bench.store(name).logs()["status"].value_counts().rows()
    assert differences == [], (differences, statuses, last.err)
    logs = bench.store(name).logs()
    assert logs["path"].n_unique() == logs["key"].n_unique() == logs.height, logs
    codes = f"exit {first.code}, then {last.code}" if first else f"exit {last.code}"
    return f"{codes}: {logs.height} logs, same results"


QUICK: tuple[Callable[[Bench], str], ...] = (
    process_of_a_log_killed,
    log_without_end,
    log_without_measure,
    interrupted_in_one_process,
    disk_full,
    two_runs_at_once,
    parts_cut_off,
    worker_killed,
    process_of_a_log_frozen,
    store_deleted,
    links,
    private_umask_and_closed_output,
)
#: These take longer or need additional rights.
SLOW: tuple[Callable[[Bench], str], ...] = (
    interrupted,
    log_without_measure_on_a_worker,
    process_of_a_log_killed_again_and_again,
    scheduler_killed,
    terminated,
    client_killed,
    client_frozen,
    disk_full_for_real,
    two_clients_of_a_cluster,
    another_numpy_on_a_worker,
    bomb,
)
