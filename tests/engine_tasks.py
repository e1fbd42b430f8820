"""What the tests of engines run in other processes: a module that imports little, so that a process begins at once."""

import os
import signal
import sys
import time

import numpy as np


def numbers(seed):
    return np.random.default_rng(seed).normal(size=1000)


def note(folder, stuck, task):
    """Leaves the id of its process. A stuck task goes on only when it is begun a second time."""
    first = not list(folder.glob(f"{task}.[0-9]*"))
    (folder / f"{task}.{os.getpid()}").touch()
    if first and task in stuck:
        time.sleep(60.0)
    return task, np.sqrt(task)


def note_node(folder, lost, task):
    """The same on a Ray cluster, where what runs on the node that is to be lost is stuck."""
    import ray

    on_it = ray.get_runtime_context().get_node_id() == lost
    (folder / f"{task}.{'lost' if on_it else 'kept'}").touch()
    if on_it:
        time.sleep(60.0)
    return note(folder, (0,), task)


def fragile(task):
    if task == "dies":
        os.kill(os.getpid(), signal.SIGKILL)
    if task == "raises":
        raise KeyError("no such\nvalve")
    if task == "leaves":
        sys.exit(7)
    if task == "returns a function":
        return lambda: None
    return task.upper()


class Kills:
    """A controller that takes its process with it."""

    name = "kills"

    def reset(self, num_rigs, control_period):
        pass

    def act(self, observation):
        os.kill(os.getpid(), signal.SIGKILL)
