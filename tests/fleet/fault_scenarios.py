"""Faults of a fleet run and their expected results: no lost or repeated log, exit codes, equal results.

Each scenario takes a bench whose folder contains ``logs`` and the store ``whole`` of an undisturbed run. It
returns a line that describes the result; assertions check the result.
"""

import gzip
import os
import resource
import shutil
import signal
import time
from collections.abc import Callable

import numpy as np
import psutil

from tests.fleet.faults import Bench, Ended, cluster, ended, left_over, stopped_log, wait_until

#: One log at a time.
HERE = ("--shard", "1/1")


def process_of_a_log_killed(bench: Bench) -> str:
    """Kill the process of a log, as the system does without memory; the log is repeated."""
    run = bench.start("child", *HERE)
    stopped_log(run.pid).kill()
    end = ended(run)
    assert len(bench.store("child").rows) == len(bench.rows("whole"))
    return _same(bench, "child", end)


def process_of_a_log_killed_again(bench: Bench) -> str:
    """Kill the process of a log twice: the run gives this log up and continues, and the next run does it."""
    run = bench.start("children", *HERE)
    for _ in range(2):
        stopped_log(run.pid).kill()
    end = ended(run)
    assert "its process ended 2 times (SIGKILL)" in end.err
    return _given_up(bench, "children", "crash", end)


def server_of_the_logs_killed(bench: Bench) -> str:
    """Kill the process from which those of the logs are forked: the log is repeated."""
    run = bench.start("server", *HERE)
    psutil.Process(stopped_log(run.pid).ppid()).kill()
    end = ended(run)
    wait_until(lambda: not left_over(bench.folder))
    return _same(bench, "server", end)


def process_of_a_log_frozen(bench: Bench) -> str:
    """Stop the process of a log by SIGSTOP: it ends after the timeout, and the next run does the log."""
    run = bench.start("frozen", "--jobs", str(bench.jobs), "--timeout", "8s")
    stopped_log(run.pid)
    end = ended(run)
    assert "it took more than 8 s; give it more time" in end.err
    wait_until(lambda: not left_over(bench.folder))
    return _given_up(bench, "frozen", "timeout", end)


def worker_killed(bench: Bench) -> str:
    """Kill a worker of a cluster within a log; another worker does it."""
    with cluster(bench.folder, workers=bench.jobs) as (address, (_, nanny, *_)):
        run = bench.start("worker", "--scheduler", address)
        log = stopped_log(nanny.pid, forked=False)
        psutil.Process(log.ppid()).kill()
        # A stopped process can't notice that its worker is gone.
        log.resume()
        return _same(bench, "worker", ended(run))


def scheduler_killed(bench: Bench) -> str:
    """Kill the scheduler: the exit code is 5, and the printed command continues without a scheduler."""
    with cluster(bench.folder, workers=bench.jobs) as (address, (scheduler, *_)):
        run = bench.start("scheduler", "--scheduler", address)
        bench.wait_for_a_log("scheduler", run)
        scheduler.kill()
        end = ended(run)
    assert end.code == 5, end.err
    assert f"Error: {address}: scheduler or workers are gone; finished logs are kept" in end.err, end.err
    assert "Finished logs are kept; to continue: imucal fleet run logs" in end.err
    return _same(bench, "scheduler", bench.finish("scheduler"), first=end)


def terminated(bench: Bench) -> str:
    """End a run by SIGTERM, as a queue does: no process remains, and the next run does the other logs."""
    end = _signalled(bench, "terminated", signal.SIGTERM)
    return _same(bench, "terminated", bench.finish("terminated"), first=end)


def client_killed(bench: Bench) -> str:
    """Kill the client: no process continues, also none that is stopped; the next run does the other logs."""
    end = _signalled(bench, "killed", signal.SIGKILL)
    return _same(bench, "killed", bench.finish("killed"), first=end)


def interrupted(bench: Bench) -> str:
    """Press Ctrl-C, which reaches all processes of a terminal: exit code 130, and a command to continue."""
    end = _signalled(bench, "interrupted", signal.SIGINT)
    assert end.code == 130, end.err
    assert "Traceback" not in end.err, end.err
    return _same(bench, "interrupted", bench.type_again(end.err), first=end)


def client_frozen(bench: Bench) -> str:
    """Stop the client by SIGSTOP and resume it, like a laptop that sleeps; it continues."""
    run = bench.start("asleep", *HERE)
    stopped_log(run.pid).resume()
    run.send_signal(signal.SIGSTOP)
    time.sleep(2.0)
    run.send_signal(signal.SIGCONT)
    return _same(bench, "asleep", ended(run))


def log_without_end(bench: Bench) -> str:
    """Read an endless device in place of a log, a terminal without input: it is refused at once."""
    (bench.folder / "endless").mkdir()
    (bench.folder / "endless" / "hang.csv").symlink_to("/dev/ptmx")
    end = bench.run("endless-store", *HERE, "--timeout", "30", logs="endless")
    assert end.code == 3, end.err
    assert "endless/hang.csv: a device; expected a regular file, copy the data to one" in end.err, end.err
    assert bench.statuses("endless-store") == {"endless/hang.csv": "unreadable"}
    return f"exit {end.code}: refused"


def log_without_measure(bench: Bench, name: str = "large", *arguments: str) -> str:
    """Read a log that needs too much memory: it is reported, and all others are done."""
    (bench.folder / name).mkdir()
    shutil.copy(next((bench.folder / "logs").rglob("*.npz")), bench.folder / name / "log.npz")
    # 60 MB of one axis.
    rate, stamps = np.ones(5_000_000, np.float32), np.arange(5_000_000) / 200
    np.savez(bench.folder / name / "huge.npz", **{"gz (rad/s)": rate, "time (s)": stamps})  # type: ignore[arg-type] # its last argument is a flag
    end = bench.run(f"{name}-store", *(arguments or HERE), "--memory", "320MB", logs=name)
    assert end.code == 0, end.err
    assert bench.statuses(f"{name}-store") == {f"{name}/huge.npz": "memory", f"{name}/log.npz": "ok"}
    return f"exit {end.code}: memory, all others done"


def log_without_measure_on_a_worker(bench: Bench) -> str:
    """Read a log that needs too much memory on a cluster: no worker is lost."""
    with cluster(bench.folder, workers=bench.jobs) as (address, _):
        return log_without_measure(bench, "large-there", "--scheduler", address)


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
    status = bench.statuses("bomb-store")
    assert status.pop("bombs/bomb.csv.gz") in {"unreadable", "memory", "timeout"}
    assert status == {"bombs/log.npz": "ok"}
    return f"exit {end.code}: all others done"


def disk_full(bench: Bench) -> str:
    """Limit the size of files: exit code 5, no torn line, and the next run does the last log."""
    (file,) = (bench.folder / "whole").glob("run-*.fleet")
    *lines, last = file.read_bytes().splitlines(keepends=True)
    room = len(b"".join(lines)) + len(last) // 2

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (room, resource.RLIM_INFINITY))

    end = bench.run("full", *HERE, limit=limit)
    assert end.code == 5, (end.code, end.err)
    assert "can't be written: File too large; free some space or choose another folder" in end.err
    assert bench.store("full").damaged == ()
    assert bench.rows("full") == bench.rows("whole")[:-1]
    return _same(bench, "full", bench.type_again(end.err), first=end)


def two_runs_at_once(bench: Bench, name: str = "both", *arguments: str) -> str:
    """Start two runs on one store: both succeed, and every log counts once."""
    first, last = [ended(run) for run in [bench.start(name, *(arguments or HERE)) for _ in range(2)]]
    assert first.code == 0, first.err
    return _same(bench, name, last, first=first)


def two_clients_of_a_cluster(bench: Bench) -> str:
    """Start two runs on one scheduler and one store: both succeed, and every log counts once."""
    with cluster(bench.folder, workers=bench.jobs) as (address, _):
        return two_runs_at_once(bench, "both-there", "--scheduler", address)


def store_deleted(bench: Bench) -> str:
    """Delete the store during a run: exit code 5 with the missing name, and the next run does all logs."""
    run = bench.start("deleted", *HERE)
    bench.wait_for_a_log("deleted", run)
    log = stopped_log(run.pid)
    shutil.rmtree(bench.folder / "deleted")
    log.resume()
    end = ended(run)
    assert end.code == 5, (end.code, end.err)
    assert "can't be written: No such file or directory" in end.err
    assert "Traceback" not in end.err
    return _same(bench, "deleted", bench.finish("deleted"), first=end)


def links(bench: Bench) -> str:
    """Add links to a log, a missing file and their own folder: each log counts once, errors are reported."""
    folder = bench.folder / "linked"
    shutil.copytree(bench.folder / "logs", folder)
    (folder / "again.npz").symlink_to(next(folder.rglob("*.npz")))
    (folder / "gone.npz").symlink_to("nowhere.npz")
    (folder / "round").symlink_to(folder, target_is_directory=True)
    end = bench.finish("linked-store", logs="linked")
    assert end.code == 0, end.err
    assert "linked/gone.npz: can't be opened: No such file or directory" in end.err, end.err
    asked, logs = bench.store("linked-store").asked.values(), bench.statuses("linked-store")
    assert (len(asked), len(logs)) == (len(bench.rows("whole")) + 2, len(bench.rows("whole")) + 1)
    assert [log.copy_of in logs for log in asked if log.copy_of] == [True]
    return f"exit {end.code}: {len(asked)} names, all others done"


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
        files = [*(bench.folder / name).rglob("*")]
        assert {path.stat().st_mode & 0o066 for path in files if path.is_file()} == {mode}
        assert {path.stat().st_mode & 0o022 for path in files} == {0}
    return _same(bench, "private", end)


def _signalled(bench: Bench, name: str, sign: signal.Signals) -> Ended:
    """Send a signal to a run while the process of a log is stopped; no process and some logs remain."""
    run = bench.start(name, *HERE)
    bench.wait_for_a_log(name, run)
    # Otherwise the run could end before.
    stopped_log(run.pid)
    (os.killpg if sign == signal.SIGINT else os.kill)(run.pid, sign)
    end = ended(run)
    wait_until(lambda: not left_over(bench.folder))
    assert 0 < len(bench.rows(name)) < len(bench.rows("whole"))
    return end


def _given_up(bench: Bench, name: str, status: str, end: Ended) -> str:
    """Return a summary after checking that a run gave one log up, which the next run does."""
    assert end.code == 0, end.err
    undisturbed = bench.statuses("whole")
    differing = [found for path, found in bench.statuses(name).items() if found != undisturbed[path]]
    assert differing == [status]
    return _same(bench, name, bench.finish(name), first=end)


def _same(bench: Bench, name: str, last: Ended, *, first: Ended | None = None) -> str:
    """Return a summary after checking that a store has every log once, with the undisturbed results."""
    assert last.code == 0, last.err
    logs = bench.rows(name)
    assert logs == bench.rows("whole"), (bench.statuses(name), last.err)
    assert bench.store(name).damaged == ()
    assert len({log["path"] for log in logs}) == len({log["key"] for log in logs}) == len(logs)
    codes = f"exit {first.code}, then {last.code}" if first else f"exit {last.code}"
    return f"{codes}: {len(logs)} logs, same results"


QUICK: tuple[Callable[[Bench], str], ...] = (
    process_of_a_log_killed,
    process_of_a_log_killed_again,
    server_of_the_logs_killed,
    process_of_a_log_frozen,
    worker_killed,
    terminated,
    client_killed,
    interrupted,
    log_without_end,
    log_without_measure,
    disk_full,
    two_runs_at_once,
    store_deleted,
    links,
    private_umask_and_closed_output,
)
#: These take longer.
SLOW: tuple[Callable[[Bench], str], ...] = (
    client_frozen,
    log_without_measure_on_a_worker,
    scheduler_killed,
    two_clients_of_a_cluster,
    bomb,
)
