"""Simulate a system in MuJoCo and record its encoders and an ideal IMU.

All values of one instant come from the same state: the engine is integrated exactly to the instant
and forward dynamics is computed there. The IMU is MuJoCo's own accelerometer and gyroscope, so it
is independent of this project's filters.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from imucalib_cli.errors import ChoiceError, InputError
from imucalib_cli.optional import optional
from imucalib_cli.robot.rotations import matrix_from_rotvec, matrix_from_rpy
from imucalib_cli.simulate.camera.view import camera_mount, see
from imucalib_cli.simulate.config import Arm, FreeBody
from imucalib_cli.simulate.mjcf import model_xml
from imucalib_cli.simulate.motion import ArmReference, GaitReference, PushPlan, instants
from imucalib_cli.simulate.options import PhysicsOptions
from imucalib_cli.simulate.recording import (
    ImuRecord,
    JointRecord,
    PoseRecord,
    Recording,
    State,
    at_once,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from imucalib_cli.arrays import Floats, Indices
    from imucalib_cli.simulate.camera_config import CameraConfig
    from imucalib_cli.simulate.config import SystemConfig

# MuJoCo has one control callback per process.
_callback = threading.Lock()


@dataclass(frozen=True)
class LowPass:
    """The low-pass filter of an IMU, which reads faster than it reports: Butterworth, second order.

    A MEMS IMU converts at some kHz, filters its readings and reports every few of them. Without the
    filter the strikes of a foot alias to low frequencies.
    """

    every: int
    """Number of inner readings for each reported one."""
    feed: Floats
    """(3,), coefficients of the readings."""
    back: Floats
    """(3,), coefficients of the filtered readings."""
    delay: float
    """s, at slow motion."""

    @classmethod
    def of(cls, bandwidth: float, rate: float, step: float) -> LowPass:
        """Design the filter for a bandwidth, Hz, at which half of the power passes.

        The rate, Hz, is that of the reports. Inner readings are at most a step, s, apart.

        Raises:
            ChoiceError: The bandwidth is beyond half of the inner rate.
        """
        from scipy.signal import butter

        every = int(np.ceil(1 / (rate * step) - 1e-9))
        inner = rate * every
        if not 0 < bandwidth < inner / 2:
            raise ChoiceError(
                f"bandwidth {bandwidth:g} Hz: must be between 0 and {inner / 2:g} Hz, half the "
                "rate of the steps; 0 measures without a filter"
            )
        feed, back = butter(2, bandwidth, fs=inner)
        order = np.arange(3)
        # The group delay at zero frequency, in inner readings.
        delay = float(order @ feed / feed.sum() - order @ back / back.sum())
        return cls(every, feed, back, delay / inner)

    def __call__(self, readings: Floats) -> Floats:
        """Filter inner readings (N, ...), which begin at rest; return the reported ones."""
        from scipy.signal import lfilter, lfilter_zi

        rest = lfilter_zi(self.feed, self.back)[:, None] * readings[:1]
        filtered, _ = lfilter(self.feed, self.back, readings, axis=0, zi=rest)
        return np.asarray(filtered[:: self.every], dtype=np.float64)


def record(
    system: SystemConfig,
    options: PhysicsOptions | None = None,
    progress: Callable[[float], None] | None = None,
    *,
    camera: CameraConfig | None = None,
) -> Recording:
    """Simulate a system without noise; options that are None are the system's own.

    ``progress`` is called now and then with the share done, 0 to 1. A camera's view is recorded
    too; its optical frame is a frame of the system, as from
    :func:`imucalib_cli.simulate.camera_config.load_camera`.

    Raises:
        ChoiceError: An option is out of range.
        InputError: MuJoCo is not installed, or the motion blew up.
    """
    options = options or PhysicsOptions()
    engine = optional("mujoco", "simulation needs", "simulate")
    if options.inertia is not None and system.free_body is not None:
        system = replace(system, free_body=replace(system.free_body, inertia=options.inertia))
    chosen = _chosen(system, options)
    duration, imu_rate, robot_rate, step = (
        _positive(chosen[key], key.replace("imu", "IMU").replace("_", " "))
        for key in ("duration", "imu_rate", "robot_rate", "step")
    )
    if not 0.0 <= chosen["gravity"] < np.inf:
        raise ChoiceError(f"gravity {chosen['gravity']:g}: must be zero or positive")
    groups = _publishers(system, options.publishers)
    R_parent_imu, t_parent_imu = matrix_from_rpy(chosen["mount_rpy"]), np.array(chosen["mount_xyz"])
    R_level_world = matrix_from_rotvec([*options.base_tilt, 0.0])
    gravity_world = np.asarray(R_level_world @ [0.0, 0.0, -chosen["gravity"]])
    bandwidth = chosen["bandwidth"]
    low_pass = LowPass.of(bandwidth, imu_rate, step) if bandwidth else None
    imus = [(system.parent, R_parent_imu, t_parent_imu)]
    imus += [(imu.parent, matrix_from_rpy(imu.rpy), np.array(imu.xyz)) for imu in system.imus]
    model = engine.MjModel.from_xml_string(
        model_xml(
            system,
            imus,
            gravity_world,
            camera_mount(system, camera.frame.link) if camera else None,
        )
    )
    data = engine.MjData(model)
    control = _control(system, options, duration, data)

    every = low_pass.every if low_pass else 1
    inner_t = instants(imu_rate * every, duration)
    imu_t = inner_t[::every]
    phases = [k / len(groups) + options.robot_phase for k in range(len(groups))]
    robot_t = [instants(robot_rate, duration, phase) for phase in phases]
    camera_t = np.zeros(0) if camera is None else instants(camera.rate, duration)
    # Instants of several clocks that differ only by rounding are one instant.
    events = np.unique(np.round(np.concatenate([inner_t, *robot_t, camera_t]), 12))

    def at(t: Floats) -> Indices:
        return np.searchsorted(events, np.round(t, 12))

    with _callback:
        previous = engine.get_mjcb_control()
        engine.set_mjcb_control(control)
        try:
            q, qd, qdd, sensors = _run(engine, model, data, events, step, progress=progress)
        finally:
            engine.set_mjcb_control(previous)
    bad = (engine.mjtWarning.mjWARN_BADQPOS, engine.mjtWarning.mjWARN_BADQACC)
    if not np.isfinite(sensors).all() or any(data.warning[kind].number for kind in bad):
        raise InputError(f"{system.name}: the motion blew up; use a shorter step or softer drives")

    inner, seen = sensors[at(inner_t), : 6 * len(imus)], sensors[at(camera_t), 6 * len(imus) :]
    read = inner if low_pass is None else low_pass(inner)
    imu, *others = (
        ImuRecord.ideal(imu_t, one[:, :3].copy(), one[:, 3:].copy())
        for one in np.split(read, len(imus), axis=1)
    )
    rows = at(imu_t)
    return Recording(
        system=system,
        physics=replace(options, **chosen),
        R_parent_imu=R_parent_imu,
        t_parent_imu=t_parent_imu,
        gravity_world=gravity_world,
        imu=imu,
        others=tuple(others),
        imu_delay=low_pass.delay if low_pass else 0.0,
        robot=_robot(system, groups, robot_t, [q[at(t)] for t in robot_t]),
        state=State(t=imu_t, position=q[rows], velocity=qd[rows], acceleration=qdd[rows]),
        engine=f"MuJoCo {engine.__version__}",
        camera=see(camera, camera_t, seen[:, :3], seen[:, 3:]) if camera else None,
    )


def _chosen(system: SystemConfig, options: PhysicsOptions) -> dict[str, Any]:
    """Options, or the system's own values where they are None."""
    own = {
        "duration": system.duration,
        "imu_rate": system.rates.imu,
        "robot_rate": system.rates.robot,
        "step": system.rates.step,
        "gravity": system.gravity,
        "mount_xyz": system.imu.xyz,
        "mount_rpy": system.imu.rpy,
        "bandwidth": system.bandwidth,
    }
    return own | {key: value for key in own if (value := getattr(options, key)) is not None}


def _positive(value: float, name: str) -> float:
    if not (np.isfinite(value) and value > 0):
        raise ChoiceError(f"{name} {value:g}: must be positive")
    return float(value)


def _control(system: SystemConfig, options: PhysicsOptions, duration: float, data: Any) -> Any:
    """Set the start of the joints; return the control callback for MuJoCo.

    MuJoCo calls it at every stage of every step, so that inputs are smooth in time.
    """
    mover = system.mover
    if isinstance(mover, FreeBody):
        plan, mass, inertia = PushPlan(mover, options.profile), mover.mass, np.array(mover.inertia)

        def push(_model: Any, data: Any) -> None:
            force, torque, brake = plan(data.time)
            velocity = data.qvel  # linear in the world, angular in the body, as qfrc_applied
            data.qfrc_applied[:3] = force - brake * mass * velocity[:3]
            data.qfrc_applied[3:] = torque - brake * inertia * velocity[3:]

        return push
    reference = (
        ArmReference(mover, duration) if isinstance(mover, Arm) else GaitReference(mover, duration)
    )
    data.qpos[len(data.qpos) - len(mover.joints) :] = reference(0.0)[0]
    lead = np.array(mover.drives.damping) / np.array(mover.drives.stiffness)

    def follow(_model: Any, data: Any) -> None:
        position, rate = reference(data.time)
        # kp (ctrl - q) - kv q' becomes kp (ref - q) + kv (ref' - q').
        data.ctrl[:] = position + lead * rate

    return follow


def _run(
    engine: Any,
    model: Any,
    data: Any,
    events: Floats,
    step: float,
    *,
    progress: Callable[[float], None] | None,
) -> tuple[Floats, Floats, Floats, Floats]:
    q = np.empty((len(events), model.nq))
    qd, qdd = np.empty((2, len(events), model.nv))
    sensors = np.empty((len(events), model.nsensordata))
    t = 0.0
    for i, until in enumerate(events.tolist()):
        if until > t:
            steps = max(1, int(np.ceil((until - t) / step - 1e-6)))
            model.opt.timestep = (until - t) / steps
            for _ in range(steps):
                engine.mj_step(model, data)
            data.time = t = until
        engine.mj_forward(model, data)
        q[i], qd[i], qdd[i], sensors[i] = data.qpos, data.qvel, data.qacc, data.sensordata
        if progress is not None and i % 1000 == 0:
            progress(i / len(events))
    return q, qd, qdd, sensors


def _publishers(system: SystemConfig, number: int) -> list[list[int]]:
    """Columns of each publisher's joints."""
    joints = len(system.joints)
    if joints == 0 and number != 1:
        raise ChoiceError(f"{system.name} has no joints to split over {number} publishers")
    if not 1 <= number <= max(joints, 1):
        raise ChoiceError(f"{number} publishers: {system.name} has {joints} joints to split")
    return [part.tolist() for part in np.array_split(np.arange(joints), number)]


def _robot(
    system: SystemConfig, groups: list[list[int]], times: list[Floats], positions: list[Floats]
) -> tuple[JointRecord | PoseRecord, ...]:
    names = [joint.name for joint in system.joints]
    if not names:
        (t,), (q,) = times, positions
        pose = PoseRecord(
            **at_once(t),
            parent=system.world,
            child=system.parent,
            position=q[:, :3],
            quaternion_xyzw=q[:, [4, 5, 6, 3]],
        )
        return (pose,)
    return tuple(
        JointRecord(
            **at_once(t),
            names=tuple(names[c] for c in columns),
            position=q[:, q.shape[1] - len(names) :][:, columns],
        )
        for columns, t, q in zip(groups, times, positions, strict=True)
    )
