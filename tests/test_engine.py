"""Engines: the same results everywhere, whatever raises, dies or is taken away in the middle."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from hydro_env.benchmark import cells, command
from hydro_env.errors import InputError
from hydro_env.parallel import ATTEMPTS, Failure, Store, run
from tests import engine_tasks
from tests.engine_tasks import Kills, fragile, note, note_node, numbers

ROOT = Path(__file__).parents[1]


def scores_in(folder):
    """What scores.json holds, measured times aside."""
    return json.loads((folder / "scores.json").read_text()) | {"decision_us": None}


SMALL = {"selection": command.Selection("full", ["val"], ["setpoint_steps", "sine"], 3), "progress": False}


def begun(folder, task):
    """The processes that have begun a task; waits for the first."""
    for _ in range(600):
        if found := [int(path.suffix[1:]) for path in folder.glob(f"{task}.[0-9]*")]:
            return found
        time.sleep(0.05)
    raise AssertionError(f"task {task} was never begun")


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def gone(pids, seconds=10.0):
    end = time.monotonic() + seconds
    while time.monotonic() < end and any(alive(pid) for pid in pids):
        time.sleep(0.05)
    return not any(alive(pid) for pid in pids)


def same(one, other):
    return len(one) == len(other) and all(a.tobytes() == b.tobytes() for a, b in zip(one, other, strict=True))


def test_results_are_the_same_and_in_order():
    here = run(range(9), numbers, engine="serial", progress=False)
    assert same(here, run(range(9), numbers, engine="local", jobs=2, progress=False))
    assert same(here, [numbers(seed) for seed in range(9)])
    assert run([], numbers, jobs=2, progress=False) == []


def kill_first(folder, task):
    """Kills, in the background, the process that begins a task first."""

    def kill():
        os.kill(begun(folder, task)[0], signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    return thread


def test_killed_worker_loses_nothing(tmp_path):
    """Also with the last task, when the other process has nothing left to do."""
    killers = [kill_first(tmp_path, task) for task in (1, 4)]
    results = run(range(5), partial(note, tmp_path, (1, 4)), jobs=2, progress=False)
    assert results == [(task, np.sqrt(task)) for task in range(5)]
    assert [len(begun(tmp_path, task)) for task in range(5)] == [1, 2, 1, 1, 2]
    for killer in killers:
        killer.join()


def check_fragile(results, died):
    one, dies, raises, leaves, other, last = results
    assert (one, last) == ("ONE", "LAST")
    assert isinstance(dies, Failure) and died in dies.reason and f"{ATTEMPTS} times" in dies.reason
    line = rf"\({re.escape(engine_tasks.__file__)} line \d+\)"
    assert re.fullmatch(rf"KeyError: 'no such\\nvalve' {line}", raises.reason)
    assert re.fullmatch(f"SystemExit: 7 {line}", leaves.reason)
    assert isinstance(other, Failure) and "cannot be sent" in other.reason


FRAGILE = ["one", "dies", "raises", "leaves", "returns a function", "last"]


def test_what_kills_or_raises_is_named_and_the_rest_goes_on():
    check_fragile(run(FRAGILE, fragile, jobs=2, progress=False), "SIGKILL")


def test_task_that_cannot_be_sent_is_named():
    first, second = run([lambda: None, "b"], fragile, jobs=2, progress=False)
    assert "cannot be sent" in first.reason and second == "B"


INTERRUPTED = """
import pathlib, signal, sys
sys.path.insert(0, {root!r})
from functools import partial
from tests.engine_tasks import note
from hydro_env.parallel import run
if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a job in the background begins with it ignored
    run(range(100), partial(note, pathlib.Path({folder!r}), range(100)), jobs=2, progress=False)
"""


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="looks at /proc")
@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_no_process_is_left_behind(tmp_path, how):
    script = tmp_path / "script.py"
    folder = tmp_path / "notes"
    folder.mkdir()
    script.write_text(INTERRUPTED.format(root=str(ROOT), folder=str(folder)))
    main = subprocess.Popen([sys.executable, str(script)], stderr=subprocess.DEVNULL)
    pids = {*begun(folder, 0), *begun(folder, 1)}
    main.send_signal(how)
    assert main.wait(10) != 0
    assert len(pids) == 2 and gone(pids)


def test_stored_results_are_not_made_again(tmp_path):
    calls = []

    def work(task):
        calls.append(task)
        if task == 2:
            raise ValueError
        return task * 10

    def store():
        return Store(tmp_path / "cells", lambda task: None if task == 3 else str(task))

    first = run(range(4), work, progress=False, store=store())
    assert first == [0, 10, first[2], 30] and first[2].reason.startswith("ValueError: ")
    for path in (tmp_path / "cells").iterdir():
        if path.stat().st_mtime_ns == max(each.stat().st_mtime_ns for each in path.parent.iterdir()):
            path.write_bytes(b"damaged")
            break
    del calls[:]
    assert run(range(4), work, progress=False, store=store()) == first
    assert {2, 3} < set(calls) and len(calls) == 3  # failed; not to be kept; damaged


def test_a_damaged_result_is_computed_again(tmp_path):
    """Also one that would still load, as another number."""
    store = Store(tmp_path / "cells", str)
    store.put(1, 1234567)
    (path,) = (tmp_path / "cells").iterdir()
    whole = path.read_bytes()
    for damaged in [
        b"",
        whole[:-1],
        *(whole[:n] + bytes([whole[n] ^ 1]) + whole[n + 1 :] for n in range(len(whole))),
    ]:
        path.write_bytes(damaged)
        assert store.get(1) is None
    path.write_bytes(whole)
    assert store.get(1) == 1234567


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="no permissions of this kind")
def test_results_that_others_could_have_written_are_not_loaded(tmp_path):
    Store(tmp_path / "cells", str)
    (tmp_path / "cells").chmod(0o775)
    with pytest.raises(InputError, match=r"run code when .* other users can write there"):
        Store(tmp_path / "cells", str)


def test_benchmark_keeps_finished_cells(tmp_path, monkeypatch):
    mine = tmp_path / "mine.py"
    text = (
        "import numpy as np\n"
        "class Mine:\n"
        "    def reset(self, num_rigs, control_period): pass\n"
        "    def act(self, observation): return np.full((len(observation), 2), 0.2)\n"
    )
    mine.write_text(text)
    given = {"controllers": ["pid_paper", f"{mine}:Mine"], "cells_folder": tmp_path / "cells", **SMALL}
    driven = []
    roll_out = cells.roll_out

    def counted(controller, seeds, **where):
        driven.append(controller.name)
        return roll_out(controller, seeds, **where)

    monkeypatch.setattr(cells, "roll_out", counted)
    first = command.run(None, **given)
    assert driven == ["pid_paper"] * 2 + ["Mine"] * 2
    assert command.run(None, **given) == first and len(driven) == 4
    mine.write_text(text.replace("0.2", "0.3"))
    again = command.run(None, **given)
    assert driven[4:] == ["Mine"] * 2 and again != first
    command.run(None, **given, conditions=command.Conditions(seed=1))
    assert len(driven) == 10


def test_benchmark_names_a_controller_that_kills():
    scores = command.run(
        None,
        controllers=[Kills(), "pid_paper"],
        jobs=2,
        **{**SMALL, "selection": command.Selection("full", ["val"], ["sine"], 3)},
    )
    assert [entry["controller"] for entry in scores["failed"]] == ["kills"]
    assert all("SIGKILL" in entry["reason"] for entry in scores["failed"])
    assert {row["controller"] for row in scores["rows"]} == {"pid_paper"}


def test_benchmark_is_the_same_on_every_engine(tmp_path):
    for engine, jobs in (("serial", 1), ("local", 2)):
        command.run(tmp_path / engine, controllers=["pid_paper"], engine=engine, jobs=jobs, **SMALL)
    one, two = (scores_in(tmp_path / engine) for engine in ("serial", "local"))
    assert one == two


def test_unknown_engine():
    with pytest.raises(InputError, match="serial, local, ray"):
        run([1], numbers, engine="rya", progress=False)


def test_ray_that_is_not_there(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(InputError, match=r"'\.\[ray\]'") as caught:
        run([1], numbers, engine="ray", progress=False)
    assert "\n" not in str(caught.value)


# --- with Ray ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def cluster():
    """A Ray cluster of two nodes on this machine, one CPU each; the second node can be taken away."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.delenv("RAY_ADDRESS", raising=False)
        small = {"num_cpus": 1, "object_store_memory": 80_000_000, "include_dashboard": False}
        made = Cluster(initialize_head=True, head_node_args=small)
        try:
            made.add_node(num_cpus=1, object_store_memory=80_000_000)
            made.wait_for_nodes()
            patch.setenv("RAY_ADDRESS", made.address)
            yield made
        finally:
            made.shutdown()


def test_no_cluster_answers(monkeypatch, tmp_path):
    pytest.importorskip("ray")
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:1")
    with pytest.raises(InputError, match="no Ray cluster answers at RAY_ADDRESS=127") as caught:
        run([1], numbers, engine="ray", progress=False)
    assert "\n" not in str(caught.value)
    monkeypatch.delenv("RAY_ADDRESS")  # and one that was there once
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))
    (tmp_path / "ray").mkdir()
    (tmp_path / "ray" / "ray_current_cluster").write_text("127.0.0.1:1")
    with pytest.raises(InputError, match="ray start --head"):
        run([1], numbers, engine="ray", progress=False)


@pytest.mark.slow
def test_ray_gives_the_same(cluster, tmp_path):
    assert same(run(range(9), numbers, engine="ray", progress=False), [numbers(seed) for seed in range(9)])
    check_fragile(run(FRAGILE, fragile, engine="ray", progress=False), "WorkerCrashedError")
    for engine in ("serial", "ray"):
        command.run(tmp_path / engine, controllers=["pid_paper", "cross_coupled"], engine=engine, **SMALL)
    one, two = (scores_in(tmp_path / engine) for engine in ("serial", "ray"))
    assert one == two


@pytest.mark.slow
def test_ray_node_with_another_hydro_env(cluster, monkeypatch):
    monkeypatch.setattr("hydro_env.parallel.ray_engine.fingerprint", lambda: "something else")
    with pytest.raises(InputError, match="another hydro_env"):
        run([1], numbers, engine="ray", progress=False)


@pytest.mark.slow
def test_ray_worker_and_node_lost_in_the_middle(cluster, tmp_path):
    """The last test of this cluster: it leaves one node."""
    (node,) = cluster.worker_nodes

    def take_away():
        while not list(tmp_path.glob("*.lost")):
            time.sleep(0.05)
        cluster.remove_node(node, allow_graceful=False)

    threads = [kill_first(tmp_path, 0), threading.Thread(target=take_away)]
    threads[1].start()
    results = run(range(10), partial(note_node, tmp_path, node.node_id), engine="ray", progress=False)
    assert results == [(task, np.sqrt(task)) for task in range(10)]
    for thread in threads:
        thread.join()
    assert not cluster.worker_nodes and len(begun(tmp_path, 0)) == 2
    assert all((tmp_path / f"{path.stem}.kept").exists() for path in tmp_path.glob("*.lost"))
