"""What a plant says of rigs that it could not follow."""

from __future__ import annotations

from hydro_env.plant import Plant


def test_a_rig_that_is_lost_says_which_channel_when_and_by_which_state() -> None:
    plant = Plant("paper", 3)
    plant.set("D", [1e-6, 1.0], rows=[1])  # rings against its line within a tenth of a microsecond
    for _ in range(3):
        plant.step([60.0, 0.0], 0.0, 0.01)
    assert plant.lost == []
    for _ in range(3):
        plant.step([60.0, 0.0], [0.0, 1e6], 0.01)
    (lost,) = plant.lost
    assert (lost.rig, lost.channel) == (1, 2) and 0.03 - 1e-12 <= lost.time < 0.04
    assert lost.state in ("pressure", "speed") and "channel 2 cannot follow" in str(lost)
    assert plant.diverged.tolist() == [False, True, False]
    plant.reset()
    assert plant.lost == []
