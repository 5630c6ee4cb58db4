"""Logs that are not what the data sheet of the IMU named allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.signal import butter, lfilter

from imucalib_cli.simulate.load import load_imu
from imucalib_cli.simulate.noise import corrupt
from tests.troubleshooting.scene import RATE, Scene, Seen, clean, noisy, provokes, with_imu

ARM = "rihibot"


@provokes("imu-noisier")
def _(scene: Scene) -> Seen:
    return scene.run_arm(corrupt(clean(ARM), load_imu("bmi088"), 3), "--imu-model", "adis16495")


@provokes("imu-quieter")
def _(scene: Scene) -> Seen:
    return scene.run_arm(noisy(ARM), "--imu-model", "bmi270")


@provokes("imu-filtered")
def _(scene: Scene) -> Seen:
    recording = corrupt(clean(ARM), load_imu("bmi270"), 3)
    b, a = butter(2, 0.12 * RATE, fs=RATE)
    gyro, accel = (lfilter(b, a, x, axis=0) for x in (recording.imu.gyro, recording.imu.accel))
    recording = with_imu(recording, gyro=gyro, accel=accel)
    return scene.run_arm(recording, "--imu-model", "bmi270")


@provokes("imu-bias-far")
def _(scene: Scene) -> Seen:
    wild = replace(load_imu("adis16448"), gyro_bias=(0.2, 0.0, -0.1))
    return scene.run_arm(corrupt(clean(ARM), wild, 3), "--imu-model", "adis16448")


@provokes("imu-beyond-range")
def _(scene: Scene) -> Seen:
    accel = noisy(ARM).imu.accel.copy()
    accel[np.arange(50, len(accel), 200), 0] = 250.0
    return scene.run_arm(with_imu(noisy(ARM), accel=accel), "--imu-model", "bmi088")


@provokes("imu-model-unknown")
def _(scene: Scene) -> Seen:
    return scene.cli("run", "any.mcap", "--imu-model", "bmi0888")


@provokes("imu-model-topic")
def _(scene: Scene) -> Seen:
    return scene.cli("run", "any.mcap", "--imu-model", "/imu/data")
