"""Binaries for Windows in an FMU, made by Zig: what the library exports and, under Wine, that it equals the kernel."""

from __future__ import annotations

import importlib.util
import re
import shutil
import struct
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from hydro_env.cli import main
from hydro_env.export.fmu.build import export_fmu
from hydro_env.plant import Plant, load_model

needs_zig = pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="no Zig (extra `windows`)")
PERIOD, STEPS = 0.01, 60
DRIVER = r"""
#include <stdio.h>
#include <stdlib.h>
#include <windows.h>
typedef struct { void *log; void *(*get)(size_t, size_t); void (*put)(void *); void *done, *environment; } Callbacks;
static void report(void *e, const char *n, int s, const char *c, const char *m, ...) { puts(m); }
#define F(type, name) type name = (type)(void *)GetProcAddress(library, #name)
typedef void *(*Make)(const char *, int, const char *, const char *, const Callbacks *, int, int);
typedef int (*Setup)(void *, int, double, double, int, double);
typedef int (*Plain)(void *);
typedef int (*Set)(void *, const unsigned *, size_t, const double *);
typedef int (*Get)(void *, const unsigned *, size_t, double *);
typedef int (*Step)(void *, double, double, int);
int main(int count, char **given) {
    HMODULE library = LoadLibraryA(given[1]);
    F(Make, fmi2Instantiate); F(Setup, fmi2SetupExperiment); F(Plain, fmi2EnterInitializationMode);
    F(Plain, fmi2ExitInitializationMode); F(Set, fmi2SetReal); F(Get, fmi2GetReal); F(Step, fmi2DoStep);
    Callbacks callbacks = { (void *)report, calloc, free, 0, 0 };
    void *unit = fmi2Instantiate("unit", 1, given[2], "", &callbacks, 0, 0);
    unsigned in[2] = { atoi(given[3]), atoi(given[4]) }, out[2] = { atoi(given[5]), atoi(given[6]) };
    double command[2], speed[2];
    if (!unit || fmi2SetupExperiment(unit, 0, 0, 0, 0, 0)) return 1;
    if (fmi2EnterInitializationMode(unit) || fmi2ExitInitializationMode(unit)) return 1;
    for (int n = 0; n < 60; n++) {
        command[0] = 10.0 - n / 4; command[1] = n / 4 - 5.0;
        if (fmi2SetReal(unit, in, 2, command) || fmi2DoStep(unit, n * 0.01, 0.01, 1)) return 2;
        if (fmi2GetReal(unit, out, 2, speed)) return 2;
        printf("%.17g %.17g\n", speed[0], speed[1]);
    }
    return 0;
}
"""


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU 2.0 for Windows and this machine, unpacked."""
    folder = tmp_path_factory.mktemp("windows")
    made = export_fmu(load_model("paper_dead_zone"), folder, (2,), ("linux64", "win64"))
    assert not made.note
    with zipfile.ZipFile(made.files[0]) as archive:
        archive.extractall(folder / "unit")
    return folder / "unit"


def exported(library: bytes) -> set[str]:
    """The names in the export table of a 64-bit DLL (Microsoft, PE Format)."""
    header = struct.unpack_from("<I", library, 0x3C)[0]
    assert library[:2] == b"MZ" and library[header : header + 4] == b"PE\0\0"
    machine, sections = struct.unpack_from("<HH", library, header + 4)
    size = struct.unpack_from("<H", library, header + 20)[0]
    optional = header + 24
    assert machine == 0x8664 and struct.unpack_from("<H", library, optional)[0] == 0x20B
    table = struct.unpack_from("<I", library, optional + 112)[0]

    def place(address: int) -> int:
        for n in range(sections):
            length, start, _, offset = struct.unpack_from("<IIII", library, optional + size + 40 * n + 8)
            if start <= address < start + length:
                return address - start + offset
        raise ValueError(hex(address))

    count = struct.unpack_from("<I", library, place(table) + 24)[0]
    names = struct.unpack_from("<I", library, place(table) + 32)[0]
    starts = [place(each) for each in struct.unpack_from(f"<{count}I", library, place(names))]
    return {library[start : library.index(b"\0", start)].decode() for start in starts}


@needs_zig
@pytest.mark.slow
def test_the_library_exports_what_the_standard_asks_for(unit: Path) -> None:
    """All functions of FMI 2.0 for co-simulation that the source has, and nothing of the plant's."""
    (library,) = (unit / "binaries" / "win64").glob("*.dll")
    wanted = set(
        re.findall(r"^EXPORT .*FMI\((fmi2\w+)\)", (unit / "sources" / "fmi2.c").read_text(), re.MULTILINE)
    )
    assert len(wanted) > 20 and exported(library.read_bytes()) == wanted
    assert (unit / "binaries" / "linux64").is_dir()


@needs_zig
@pytest.mark.slow
@pytest.mark.skipif(shutil.which("wine") is None, reason="no Wine")
def test_it_computes_under_wine_what_the_kernel_does(unit: Path, tmp_path: Path) -> None:
    (library,) = (unit / "binaries" / "win64").glob("*.dll")
    (tmp_path / "driver.c").write_text(DRIVER)
    build = [
        sys.executable,
        "-m",
        "ziglang",
        "cc",
        "-target",
        "x86_64-windows-gnu",
        "driver.c",
        "-o",
        "driver.exe",
    ]
    subprocess.run(build, cwd=tmp_path, check=True)
    text = (unit / "modelDescription.xml").read_text()
    references = [
        re.search(rf'name="{name}" valueReference="(\d+)"', text)[1]
        for name in ("command_1", "command_2", "speed_1", "speed_2")
    ]
    token = re.search(r'guid="([^"]+)"', text)[1]
    command = ["wine", "driver.exe", str(library), token, *references]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    got = np.array([line.split() for line in done.stdout.split("\n") if line.strip()], float)
    plant, expected = Plant("paper_dead_zone"), []
    for n in range(STEPS):
        plant.step(np.array([10.0 - n // 4, n // 4 - 5.0]), 0.0, PERIOD)
        expected.append(plant.get("speed")[0].copy())
    assert np.abs(np.array(expected)).max() > 10.0
    assert np.abs(got - np.array(expected)).max() < 1e-9


@pytest.mark.parametrize(("name", "says"), [("win46", "did you mean 'win64'?"), ("win64", "windows")])
def test_bad_platforms(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str, says: str
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda *_: None)
    with pytest.raises(SystemExit) as ended:
        main(["export", "fmu", "--model", "paper", "--platform", name, "--out", str(tmp_path / "out")])
    said = capsys.readouterr().err
    assert ended.value.code == 2 and said.count("\n") == 1 and says in said
    assert not (tmp_path / "out").exists()
