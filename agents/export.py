"""Writes a trained model as a policy file, or a policy file as ONNX.

`python -m agents.export MODEL.zip --config configs/ppo.yml --out policy.npz` does by hand what a training run does by itself.
`python -m agents.export policy.npz --out policy.onnx` writes the network for other runtimes, see `hydro_env.export.onnx`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from agents.command import run_command
from hydro_env.controllers.learned.policy_interface import make_interface
from hydro_env.errors import InputError
from hydro_env.export.onnx import export_onnx
from hydro_env.pickles import distrust
from hydro_env.training.config import read_config
from hydro_env.training.export import export_policy


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "model", type=Path, help="a model saved by Stable-Baselines3 (.zip), or a policy file (.npz)"
    )
    parser.add_argument("--config", type=Path, help="the file a model was trained with")
    parser.add_argument(
        "--out", type=Path, required=True, help="what to write: a policy file, or ONNX from one"
    )
    arguments = parser.parse_args()

    def run() -> None:
        torch.set_num_threads(1)
        if arguments.model.suffix == ".npz":
            export_onnx(arguments.model, arguments.out)
            print(f"wrote {arguments.out}")
            return
        if arguments.config is None:
            raise InputError("a model needs --config, the file it was trained with")
        config = read_config(arguments.config)
        if not arguments.model.is_file():
            raise InputError(f"{arguments.model}: no such file")
        if reason := distrust(arguments.model):
            raise InputError(f"{arguments.model}: a model runs code when it is loaded, and {reason}")
        try:
            model = config.algorithm.load(arguments.model, device="cpu")
        except Exception as problem:  # a pickle of anything
            reason = f"{type(problem).__name__}: {problem}"
            raise InputError(
                f"{arguments.model}: is no whole model of {config.training.algorithm} ({' '.join(reason.split())})"
            ) from None
        interface = make_interface(config.training.interface)
        about = {"algorithm": config.training.algorithm, "config": config.text}
        export_policy(model, arguments.out, interface.table(), about)
        print(f"wrote {arguments.out}")

    run_command(run)


if __name__ == "__main__":
    main()
