"""What `nermo bench sensors` measures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from nermo_sensors.bench.figure import figure_facts
from nermo_sensors.bench.judgement import judge_run, update_times
from nermo_sensors.bench.rig import Rig
from nermo_sensors.cells.piezoresistive import PiezoresistiveParameters
from nermo_sensors.parameters import load_tactile

FIT_SEED, TUNE_SEED, JUDGE_SEED = 1, 2, 3
"""Runs of the simulated bench: one to identify, one to tune, one to judge (C 4.3.2.1)."""


def bench_sensors(
    robot: str = "cheetah_cub",
    quick: bool = False,
    seed: int = JUDGE_SEED,
    pictures: Path | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Time of an update, and the estimators on a run of the simulated bench that they have never seen.

    Calibration and covariances are those of the robot's parameter file, from runs 1 and 2 (docs/nermo_sensors.md).
    """
    parameters = load_tactile(robot)
    rig = Rig(peak=2.8 * parameters.cell(PiezoresistiveParameters).saturation_force)
    if quick:
        rig = Rig(peak=rig.peak, periods=3, seconds=2.0)
    recording = rig.run(parameters, seed)
    rows, traces = judge_run(parameters, recording, progress=progress)
    facts: dict[str, Any] = {
        **update_times(parameters, samples=300 if quick else 2000),
        "feet": 4,
        "rows": [row for row in rows if row["frequency_hz"] is not None],
        "overall": [row for row in rows if row["frequency_hz"] is None],
        "requirements": dynamic_requirements(rows, rig.peak),
        "figure_4_8": figure_facts(2 if quick else 20, 4.0 if quick else 60.0),
        "seed": seed,
    }
    if pictures is not None:
        from nermo_sensors.plots import plot_estimates, plot_residual_distribution, plot_sensor_curve

        pictures.mkdir(parents=True, exist_ok=True)
        plot_sensor_curve(parameters, recording, pictures / "sensor_curve.png")
        plot_estimates(recording, traces, pictures / "estimates.png")
        plot_residual_distribution(recording, traces, pictures / "residuals.png")
        facts["pictures"] = sorted(str(path) for path in pictures.glob("*.png"))
    return facts


def dynamic_requirements(rows: list[dict[str, Any]], peak: float) -> list[dict[str, Any]]:
    """What table 4.1 asks of the estimate while the load changes, for the memory filter on bumps of `peak` [N]."""
    memory = {row["frequency_hz"]: row for row in rows if row["estimator"] == "memory"}
    fastest = max(frequency for frequency in memory if frequency is not None)
    reached = 1.0 + memory[fastest]["peak_error_n"] / peak
    worst = max(abs(row["peak_error_n"]) for row in memory.values())
    return [
        {
            "requirement": "load range, dynamic",
            "asked": "0 to 20 N",
            "found": f"bumps of {peak:.0f} N with a peak error of {worst:.2g} N at worst",
            "met": bool(peak - worst >= 20.0),
        },
        {
            "requirement": "frequency response",
            "asked": "> 4 Hz",
            "found": f"{100.0 * reached:.1f} % of the peak at {fastest:g} Hz, the fastest on the bench (-3 dB is 71 %)",
            "met": bool(fastest >= 4.0 and reached > 0.5**0.5),
        },
        {
            "requirement": "sensitivity, of the estimate",
            "asked": "< 200 mN",
            "found": f"RMSE {1e3 * memory[None]['rmse_n']:.0f} mN over all frequencies",
            "met": bool(memory[None]["rmse_n"] < 0.2),
        },
    ]
