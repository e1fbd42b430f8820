"""The training files that ship: those of the shipped agents, and quick ones that only show that training works."""

from pathlib import Path

from hydro_env.errors import check_known

#: Their names, and what they train.
RECIPES = {
    "ppo": "the shipped agent `ppo`, from the plain observation, in a quarter of an hour",
    "ppo_short": "the same with a smaller reward, in three minutes",
    "sac": "the shipped agent `sac`, the same by SAC, in seven minutes",
    "ppo_quick": "a few seconds of PPO, to see that it works",
    "sac_quick": "a few seconds of SAC, to see that it works",
}
PACKAGE = Path(__file__).parents[1]
#: Where they lie: in an installed package, or in a checkout.
FOLDERS = (PACKAGE / "training" / "recipes", PACKAGE.parent / "configs")


def recipe(name: str) -> Path:
    """The training file of a name. InputError if there is none."""
    check_known("no recipe", [name], RECIPES)
    return next(path for folder in FOLDERS if (path := folder / f"{name}.yml").is_file())
