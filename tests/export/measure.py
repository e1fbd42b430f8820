"""Size and time of exported controllers: `python -m tests.export.measure` prints the table of docs/howto/export_a_controller.md.

Each sample of a recorded episode is timed in C, 50 times over; what a sample takes is its shortest time, which nothing has
interrupted, and the worst sample of the episode is what the table shows. Compiled with `-std=c99 -O2`.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from hydro_env.envs.observation import SCALES
from hydro_env.export.controllers import export_controller
from hydro_env.export.fmu.build import find_compiler
from tests.export.test_export_controllers import CLASSICAL, LAWS, NETWORKS, PERIOD, episode, in_python, rig_of

DRIVER = """\
#define _POSIX_C_SOURCE 199309L
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "{name}.h"
int main(void) {{
    static double samples[{rows}][9], command[2], best[{rows}];
    static {name}_state s;
    struct timespec a, b;
    FILE *file = fopen("samples", "rb");
    if (!file || fread(samples, sizeof(samples), 1, file) != 1) return 1;
    for (int turn = 0; turn < 50; turn++) {{
        {name}_reset(&s);
        for (int n = 0; n < {rows}; n++) {{
            clock_gettime(CLOCK_MONOTONIC, &a);
            {name}_step(&s, samples[n], command);
            clock_gettime(CLOCK_MONOTONIC, &b);
            double us = (b.tv_sec - a.tv_sec) * 1e6 + (b.tv_nsec - a.tv_nsec) * 1e-3;
            if (turn == 0 || us < best[n]) best[n] = us;
        }}
    }}
    double worst = 0.0;
    for (int n = 0; n < {rows}; n++) worst = best[n] > worst ? best[n] : worst;
    printf("%zu %g\\n", sizeof(s), worst);
    return 0;
}}
"""


def measure(name: str, single: bool = False) -> str:
    """A row of the table."""
    controller = in_python(name)
    controller.reset(1, PERIOD)
    samples = []

    def act(observation: np.ndarray) -> np.ndarray:
        samples.append(observation[0].astype(float) * SCALES)
        return np.asarray(controller.act(observation))

    episode(act, "setpoint_steps", *rig_of(name))
    compiler = find_compiler()
    assert compiler is not None, "a C compiler is needed"
    with tempfile.TemporaryDirectory() as room:
        folder = Path(room)
        export_controller("c", name, folder, PERIOD, "paper_dead_zone", single=single)
        (folder / "samples").write_bytes(np.array(samples).tobytes())
        (folder / "main.c").write_text(DRIVER.format(name=name, rows=len(samples)))
        flags = ["-std=c99", "-O2"]
        subprocess.run([*compiler, *flags, "-c", f"{name}.c"], cwd=folder, check=True)
        size = subprocess.run(
            ["size", f"{name}.o"], cwd=folder, check=True, capture_output=True, text=True
        ).stdout
        subprocess.run([*compiler, *flags, "main.c", f"{name}.o", "-o", "run", "-lm"], cwd=folder, check=True)
        found = subprocess.run(
            ["./run"], cwd=folder, check=True, capture_output=True, text=True
        ).stdout.split()
    code = int(size.splitlines()[1].split()[0])
    label = f"`{name}`, `--single`" if single else f"`{name}`"
    return f"| {label} | {code} | {int(found[0])} | {float(found[1]):.2g} |"


if __name__ == "__main__":
    for each in sys.argv[1:] or [*CLASSICAL, *LAWS, *NETWORKS]:
        print(measure(each), flush=True)
    if not sys.argv[1:]:
        print(measure("gru", single=True))
