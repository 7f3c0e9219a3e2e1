"""Identification finds what was put in, says how sure it is, and refuses what the data cannot tell."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from nermo_sensors.bench.rig import Rig, bump, smooth_bump
from nermo_sensors.bench.table import BenchRecording, RecordingError
from nermo_sensors.cells.piezoelectric import PiezoelectricParameters, RateAccelerationResponse
from nermo_sensors.cells.piezoresistive import LinearConductance, PiezoresistiveParameters, Sigmoid, SigmoidPair
from nermo_sensors.identification.calibrate import calibrate
from nermo_sensors.identification.fit import UnidentifiableError, Unknown, fit
from nermo_sensors.identification.piezoelectric import fit_charge, fit_rate, fit_rate_acceleration
from nermo_sensors.identification.piezoresistive import fit_memory, fit_pair, fit_static
from nermo_sensors.models.amplifier import NonInvertingAmplifier
from nermo_sensors.parameters import load_tactile

QUICK = Rig(periods=3, seconds=2.0)


@pytest.fixture(scope="module")
def run() -> BenchRecording:
    return QUICK.run(load_tactile("cheetah_cub"), seed=1)


def synthetic(seconds: float = 40.0) -> BenchRecording:
    """Bumps of 1 to 3 Hz with voltages still to be filled in."""
    time = np.arange(0.0, seconds, 0.005)
    frequency = 2.0 * np.pi * np.where(time < seconds / 3, 1.0, np.where(time < 2 * seconds / 3, 2.0, 3.0))
    force = 14.0 * (1.0 - np.cos(np.cumsum(frequency) * 0.005))
    return BenchRecording(time, force, np.zeros_like(time), np.zeros_like(time), frequency)


def test_bench_covers_what_the_thesis_asks_for(run: BenchRecording) -> None:
    hertz = np.unique(np.round(run.frequency / (2.0 * np.pi), 3))
    np.testing.assert_allclose(hertz, np.arange(0.5, 4.1, 0.5))
    assert run.force.max() == pytest.approx(28.0, rel=0.03)
    assert run.period == pytest.approx(0.005)
    full = Rig()
    assert full.sampling_frequency == 1000.0 and full.cut_off == 10.0 and full.periods == 10


def test_bench_run_is_repeatable(run: BenchRecording) -> None:
    again = QUICK.run(load_tactile("cheetah_cub"), seed=1)
    np.testing.assert_array_equal(run.piezoresistive, again.piezoresistive)


def test_bumps_are_what_they_should_be() -> None:
    assert bump(np.array([0.0, 0.45, 0.95]), 0.1) == pytest.approx([0.0, 1.0, 0.0])
    assert smooth_bump(np.array([-1.5, -1.0, 0.0, 0.5, 1.0])) == pytest.approx([0.0, 0.0, 1.0, np.exp(-1.0 / 3.0), 0.0])


def test_fits_are_as_good_as_the_thesis_found_them(run: BenchRecording) -> None:
    """C: R2 = 0.995 for the pair of sigmoids, 0.9997 for the piezoelectric cell."""
    found = calibrate(run, load_tactile("cheetah_cub"))
    assert found.fits["pair"].r_squared > 0.99
    assert found.fits["charge"].r_squared > 0.9997
    assert found.calibration.law == "charge"
    assert found.fits["rate"].r_squared < 0.6


def test_low_pass_of_the_bench_does_not_round_the_corner(run: BenchRecording) -> None:
    truth = load_tactile("cheetah_cub").cell(PiezoresistiveParameters)
    amplifier = NonInvertingAmplifier(truth.feedback_resistance, truth.reference_voltage)
    found, _ = fit_memory(run, amplifier)
    assert found.saturation_force == pytest.approx(truth.saturation_force, rel=0.03)
    assert found.rounding == pytest.approx(truth.rounding, rel=0.5)


def test_charge_amplifier_is_found_within_its_interval(run: BenchRecording) -> None:
    truth = load_tactile("cheetah_cub").cell(PiezoelectricParameters)
    found, result = fit_charge(run)
    assert found.gain == pytest.approx(truth.gain, rel=0.02)
    assert found.leak == pytest.approx(truth.leak, rel=0.02)
    low, high = result.interval["leak"]
    assert low < found.leak < high < 1.1 * found.leak


def test_pair_of_sigmoids_is_found() -> None:
    empty = synthetic()
    truth = SigmoidPair(Sigmoid(4.0, -0.5, -7.0, 0.9), Sigmoid(4.0, -0.5, -5.0, 0.9), -0.05)
    rate = np.gradient(empty.force, empty.time)
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(rate))
    found, result = fit_pair(replace(empty, piezoresistive=np.asarray(truth.voltage(empty.force, rate)) + noise))
    assert found.rising.c == pytest.approx(-7.0, abs=0.05)
    assert found.falling.c == pytest.approx(-5.0, abs=0.05)
    assert result.residual_deviation == pytest.approx(0.01, rel=0.1)
    for name, value in (("rising.b", -0.5), ("falling.a", 4.0), ("switch", -0.05)):
        low, high = result.interval[name]
        assert low - (high - low) < value < high + (high - low)


def test_law_of_the_thesis_is_found_with_its_decays() -> None:
    empty = synthetic()
    truth = RateAccelerationResponse(0.008, 25.0, 1e-4, 19.0, 0.01)
    rate = np.gradient(empty.force, empty.time)
    voltage = truth.voltage(rate, np.gradient(rate, empty.time), empty.frequency)
    found, result = fit_rate_acceleration(replace(empty, piezoelectric=np.asarray(voltage)))
    assert (found.rate_gain, found.rate_decay, found.acceleration_decay) == pytest.approx((0.008, 25.0, 19.0), rel=1e-3)
    assert result.r_squared > 0.99999


def test_static_characteristic_is_found() -> None:
    truth = LinearConductance(1.01e-5, 4.14e-5, 3.6e-4)
    force = np.linspace(0.0, 45.0, 40)
    noise = 1e-6 * np.random.default_rng(1).standard_normal(40)
    found, result = fit_static(force, truth.conductance(force) + noise)
    assert found.sensitivity == pytest.approx(truth.sensitivity, rel=0.02)
    assert found.saturation_force == pytest.approx(truth.saturation_force, rel=0.02)
    assert result.r_squared > 0.999


def test_static_characteristic_without_saturation_is_refused() -> None:
    force = np.linspace(0.0, 20.0, 40)
    with pytest.raises(UnidentifiableError, match="saturated.*forces beyond saturation"):
        fit_static(force, LinearConductance(1.01e-5, 4.14e-5, 3.6e-4).conductance(force))


def test_no_unloading_ramp_means_no_hysteresis() -> None:
    time = np.arange(0.0, 60.0, 0.005)
    force = 28.0 * time / 60.0
    recording = BenchRecording(time, force, 1.0 + 0.1 * force, np.zeros_like(time), np.full_like(time, np.nan))
    for identify in (lambda r: fit_pair(r), lambda r: fit_memory(r, NonInvertingAmplifier())):
        with pytest.raises(UnidentifiableError, match="hysteresis_width.*unloading ramp"):
            identify(recording)


def test_short_recording_means_no_creep(run: BenchRecording) -> None:
    short = run.part(slice(0, 2000))
    with pytest.raises(UnidentifiableError, match="creep_time: .* too short"):
        fit_memory(short, NonInvertingAmplifier())


def test_one_frequency_means_no_decay(run: BenchRecording) -> None:
    at_one = run.part(np.isclose(run.frequency, 2.0 * np.pi))
    with pytest.raises(UnidentifiableError, match="rate_decay.*several frequencies"):
        fit_rate_acceleration(at_one)
    with pytest.raises(UnidentifiableError, match="frequency_hz"):
        fit_rate_acceleration(replace(run, frequency=np.full_like(run.time, np.nan)))


def test_constant_force_means_no_gain(run: BenchRecording) -> None:
    with pytest.raises(UnidentifiableError, match="gain: the force never changes"):
        fit_rate(replace(run, force=np.full_like(run.time, 3.0)))


def test_parameters_that_only_act_together_are_named() -> None:
    x = np.linspace(0.0, 1.0, 100)
    unknowns = {name: Unknown(1.0, -10.0, 10.0, f"more of {name}") for name in ("a", "b", "c")}
    with pytest.raises(UnidentifiableError, match="a, b: the recording cannot tell them apart"):
        fit(unknowns, lambda v: (v["a"] + v["b"]) * x + v["c"], 2.0 * x + 0.01 * np.sin(40 * x), 0)


def test_confidence_intervals_cover_the_truth_also_with_correlated_noise() -> None:
    x, covered = np.linspace(0.0, 1.0, 500), 0
    for seed in range(40):
        white = np.random.default_rng(seed).standard_normal(520)
        noise = np.convolve(white, np.ones(21) / 21.0, mode="valid")
        unknowns = {"slope": Unknown(1.0, -10.0, 10.0, "-"), "offset": Unknown(0.0, -10.0, 10.0, "-")}
        low, high = fit(unknowns, lambda v: v["slope"] * x + v["offset"], 2.0 * x + noise, 40).interval["slope"]
        covered += low < 2.0 < high
    assert covered >= 32  # 38 of 40 in the long run; white-noise intervals would cover about 15


def test_recording_survives_a_file(run: BenchRecording, tmp_path: Path) -> None:
    run.save(tmp_path / "run.csv")
    again = BenchRecording.load(tmp_path / "run.csv")
    np.testing.assert_allclose(again.piezoelectric, run.piezoelectric)
    np.testing.assert_allclose(again.frequency, run.frequency)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,force_n\n" + "0,1\n" * 20, "column piezoresistive_v, piezoelectric_v is missing; there are: time_s"),
        ("time_s,force_n,piezoresistive_v,piezoelectric_v\n0,1,1,0\n", "has 1 rows"),
        (
            "time_s,force_n,piezoresistive_v,piezoelectric_v\n"
            + "".join(f"{0.1 * k},{'nan' if k == 4 else 1},1,0\n" for k in range(20)),
            "column force_n, row 5: nan is not a finite number",
        ),
        (
            "time_s,force_n,piezoresistive_v,piezoelectric_v\n" + "".join(f"{abs(k - 9)},1,1,0\n" for k in range(20)),
            "time does not rise at row 2",
        ),
        ("time_s,force_n,piezoresistive_v,piezoelectric_v\n" + "a,b,c,d\n" * 20, "no number"),
        ("", "cannot be read"),
    ],
    ids=["columns", "rows", "nan", "time", "text", "empty"],
)
def test_bad_recordings_are_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(RecordingError, match=message):
        BenchRecording.load(path)


def test_missing_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot be read"):
        BenchRecording.load(tmp_path / "none.csv")
