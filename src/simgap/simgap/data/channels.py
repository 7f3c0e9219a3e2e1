"""Channels of a recording, resolved in the model: what each input drives and what each output measures."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from simgap.data.errors import GapInputError, nearest
from simgap.data.mapping import InputRow, Map, OutputRow
from simgap.data.units import SI_UNITS, factor

Array = NDArray[np.float64]
Obj = mujoco.mjtObj
Sens = mujoco.mjtSensor

_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_COMPONENTS = {"x": 0, "y": 1, "z": 2}
_QUATERNION = {"w": 0, "x": 1, "y": 2, "z": 3}
_EULER = ("roll", "pitch", "yaw")

# Sensor type -> the quantities its value may be (a tendon's or an actuator's length may be a length or an angle).
_SENSOR_QUANTITIES: dict[int, tuple[str, ...]] = {
    Sens.mjSENS_ACCELEROMETER: ("acceleration",),
    Sens.mjSENS_VELOCIMETER: ("velocity",),
    Sens.mjSENS_GYRO: ("angular_velocity",),
    Sens.mjSENS_FORCE: ("force",),
    Sens.mjSENS_TORQUE: ("torque",),
    Sens.mjSENS_TOUCH: ("force",),
    Sens.mjSENS_MAGNETOMETER: ("magnetic_field",),
    Sens.mjSENS_RANGEFINDER: ("length",),
    Sens.mjSENS_TENDONPOS: ("length", "angle"),
    Sens.mjSENS_TENDONVEL: ("velocity", "angular_velocity"),
    Sens.mjSENS_ACTUATORPOS: ("angle", "length"),
    Sens.mjSENS_ACTUATORVEL: ("angular_velocity", "velocity"),
    Sens.mjSENS_ACTUATORFRC: ("torque", "force", "dimensionless"),
    Sens.mjSENS_JOINTACTFRC: ("torque", "force"),
    Sens.mjSENS_TENDONACTFRC: ("force", "torque"),
    Sens.mjSENS_FRAMEPOS: ("length",),
    Sens.mjSENS_FRAMEQUAT: ("dimensionless",),
    Sens.mjSENS_FRAMELINVEL: ("velocity",),
    Sens.mjSENS_FRAMEANGVEL: ("angular_velocity",),
    Sens.mjSENS_FRAMELINACC: ("acceleration",),
    Sens.mjSENS_FRAMEANGACC: ("angular_acceleration",),
    Sens.mjSENS_SUBTREECOM: ("length",),
    Sens.mjSENS_SUBTREELINVEL: ("velocity",),
}

_FRAME_SENSORS = {
    "position": Sens.mjSENS_FRAMEPOS,
    "orientation": Sens.mjSENS_FRAMEQUAT,
    "velocity": Sens.mjSENS_FRAMELINVEL,
    "angular_velocity": Sens.mjSENS_FRAMEANGVEL,
    "acceleration": Sens.mjSENS_FRAMELINACC,
}
_JOINT_SENSORS = {
    "position": Sens.mjSENS_JOINTPOS,
    "velocity": Sens.mjSENS_JOINTVEL,
    "torque": Sens.mjSENS_JOINTACTFRC,
    "force": Sens.mjSENS_JOINTACTFRC,
}
_TENDON_SENSORS = {
    "position": Sens.mjSENS_TENDONPOS,
    "velocity": Sens.mjSENS_TENDONVEL,
    "force": Sens.mjSENS_TENDONACTFRC,
}


_ALONG = 0.1
"""Of its way a body that slides must show at least this share along an axis that is measured."""


@dataclass(frozen=True)
class InputChannel:
    """One recorded input. ``scale`` turns the column into ctrl (actuator >= 0) or into a joint force (dof >= 0)."""

    name: str
    column: str
    kind: str
    scale: float
    actuator: int = -1
    dof: int = -1
    measured: bool = False
    linear: bool = False


@dataclass(frozen=True)
class OutputChannel:
    """One recorded output: ``scale`` turns the column into SI (``unit``, "1" of a pure number), ``address`` points into
    sensordata.

    ``euler`` is 0, 1, 2 for roll, pitch, yaw of the quaternion at ``address`` and -1 otherwise. ``qpos``/``dof`` is the
    scalar coordinate that the channel measures (value = ``origin`` + coordinate * ``gear``), -1 where it measures none.
    """

    name: str
    column: str
    quantity: str
    unit: str
    scale: float
    address: int
    sensor: str
    sensor_type: int
    component: int = 0
    euler: int = -1
    qpos: int = -1
    dof: int = -1
    gear: float = 1.0
    origin: float = 0.0
    subsystem: str = ""
    part: str = ""
    """Name of the component of a sensor that has several."""
    resolution: float = 0.0
    """What the sensor resolves, in SI, where the map says so."""

    @property
    def wrapped(self) -> bool:
        """Whether the channel is an angle on the circle (a body's roll, pitch or yaw)."""
        return self.euler >= 0

    def coordinate(self, values: Array) -> Array:
        """The coordinate of the model that values of the channel mean."""
        return (values - self.origin) / self.gear


def model_names(model: mujoco.MjModel, kind: mujoco.mjtObj) -> list[str]:
    """Names of all objects of ``kind``, by id; an unnamed one is called kind and number."""
    count = {
        Obj.mjOBJ_BODY: model.nbody,
        Obj.mjOBJ_JOINT: model.njnt,
        Obj.mjOBJ_GEOM: model.ngeom,
        Obj.mjOBJ_SITE: model.nsite,
        Obj.mjOBJ_TENDON: model.ntendon,
        Obj.mjOBJ_ACTUATOR: model.nu,
        Obj.mjOBJ_SENSOR: model.nsensor,
    }[kind]
    label = kind.name.removeprefix("mjOBJ_").lower()
    return [mujoco.mj_id2name(model, kind, i) or f"{label}_{i}" for i in range(count)]


def find(model: mujoco.MjModel, kind: mujoco.mjtObj, name: str, what: str, where: str) -> int:
    """The id of a named object; ``what`` and ``where`` say in the message what was looked for, and who asked.

    Raises:
        GapInputError: the model has none of that name; the nearest names are given.
    """
    index = mujoco.mj_name2id(model, kind, name)
    if index < 0:
        raise GapInputError(
            f"{where}: the model has no {what} {name!r}; {nearest(name, model_names(model, kind), what)}"
        )
    return int(index)


def is_servo(model: mujoco.MjModel, actuator: int, slot: int = 1) -> bool:
    """Whether an actuator feeds back its own position (slot 1) or velocity (slot 2)."""
    affine = model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_AFFINE
    return bool(affine and model.actuator_biasprm[actuator, slot] != 0.0)


def _angular(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator turns (True) or pulls and pushes (False)."""
    if model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT:
        return bool(model.jnt_type[model.actuator_trnid[actuator, 0]] == _HINGE)
    return False


def input_channel(model: mujoco.MjModel, row: InputRow, where: str, mapping: Map) -> InputChannel:
    """What a row of the map's inputs drives.

    Raises:
        GapInputError: a name that the model lacks, a unit that does not fit, or a kind that the actuator cannot take.
    """
    linear = row.hold == "linear" if row.hold else row.measured
    if row.actuator is None:
        assert row.joint is not None
        joint = find(model, Obj.mjOBJ_JOINT, row.joint, "joint", where)
        if int(model.jnt_type[joint]) not in (_HINGE, _SLIDE):
            raise GapInputError(f"{where}: joint {row.joint!r} is neither a hinge nor a slide")
        force = ("torque",) if model.jnt_type[joint] == _HINGE else ("force",)
        scale, _ = factor(row.unit, force, where)
        dof = int(model.jnt_dofadr[joint])
        return InputChannel(
            row.column, row.column, row.kind, row.sign * scale, -1, dof, row.measured, row.hold != "zero"
        )
    index = find(model, Obj.mjOBJ_ACTUATOR, row.actuator, "actuator", where)
    angular, tendon = _angular(model, index), model.actuator_trntype[index] == mujoco.mjtTrn.mjTRN_TENDON
    gear, gain = float(model.actuator_gear[index, 0]), float(model.actuator_gainprm[index, 0])
    pick = {
        "position": (("angle",), ("length",), ("length", "angle")),
        "velocity": (("angular_velocity",), ("velocity",), ("velocity", "angular_velocity")),
        "torque": (("torque",), ("force",), ("force", "torque")),
        "voltage": (("voltage",), ("voltage",), ("voltage",)),
    }[row.kind]
    scale, _ = factor(row.unit, pick[2] if tendon else pick[0] if angular else pick[1], where)
    position, velocity = is_servo(model, index, 1), is_servo(model, index, 2)
    # A servo without any gain is there and gives nothing, as where its cable came off.
    if row.kind == "position" and not position and gain != 0.0:
        hint = "add it to gains, with the robot's own kp and kd"
        raise GapInputError(f"{where}: actuator {row.actuator!r} is no position servo; {hint}")
    # A position command may come with a velocity and a torque in advance: they add to it, each in its own scale.
    leads = any(r.actuator == row.actuator and r.kind == "position" for r in mapping.inputs)
    if row.kind == "velocity":
        if not velocity or (position and not leads):
            raise GapInputError(f"{where}: actuator {row.actuator!r} is no velocity servo")
        if position:
            scale *= -float(model.actuator_biasprm[index, 2]) * gear / gain
    if row.kind == "torque":
        if (position or velocity) and not leads:
            raise GapInputError(
                f"{where}: actuator {row.actuator!r} has a controller of its own and takes no torque; "
                "give the torque at its joint with measured: true"
            )
        if gear * gain == 0.0:
            raise GapInputError(f"{where}: actuator {row.actuator!r} has zero gear or gain")
        scale /= gear * gain
    return InputChannel(row.actuator, row.column, row.kind, row.sign * scale, index, -1, row.measured, linear)


def sensor_of(spec: mujoco.MjSpec, model: mujoco.MjModel, row: OutputRow, where: str) -> str:
    """The name of the sensor that the row reads; one is added where the row names a joint, body, site or tendon."""
    where = f"{where} ({row.column})"
    if row.sensor is not None:
        find(model, Obj.mjOBJ_SENSOR, row.sensor, "sensor", where)
        return row.sensor
    what = next(n for n in ("joint", "body", "site", "tendon") if getattr(row, n) is not None)
    name = getattr(row, what)
    kind = {"joint": Obj.mjOBJ_JOINT, "body": Obj.mjOBJ_BODY, "site": Obj.mjOBJ_SITE, "tendon": Obj.mjOBJ_TENDON}[what]
    find(model, kind, name, what, where)
    table = {"joint": _JOINT_SENSORS, "tendon": _TENDON_SENSORS}.get(what, _FRAME_SENSORS)
    assert row.quantity is not None
    if row.quantity not in table:
        raise GapInputError(f"{where}: a {what} has no {row.quantity}; it has {', '.join(table)}")
    added = f"gap:{what}:{name}:{row.quantity}"
    if all(s.name != added for s in spec.sensors):
        frame = Obj.mjOBJ_XBODY if what == "body" else kind
        spec.add_sensor(name=added, type=table[row.quantity], objtype=frame, objname=name)
    return added


def _rail(model: mujoco.MjModel, sensor: int, component: int) -> tuple[int, float, float] | None:
    """What a position says of a body that can only slide along one line: address in qpos, origin and gear; else None.

    A leg on a boom, whose height is seen from outside, is one.
    """
    of, kind = int(model.sensor_objid[sensor]), int(model.sensor_objtype[sensor])
    if kind not in (int(Obj.mjOBJ_SITE), int(Obj.mjOBJ_XBODY)) or model.sensor_refid[sensor] >= 0:
        return None
    site = kind == int(Obj.mjOBJ_SITE)
    body = int(model.site_bodyid[of]) if site else of
    ways: list[int] = []
    while body > 0:
        first = int(model.body_jntadr[body])
        ways += range(first, first + int(model.body_jntnum[body]))
        body = int(model.body_parentid[body])
    if len(ways) != 1 or model.jnt_type[ways[0]] != _SLIDE:
        return None
    qpos, data = int(model.jnt_qposadr[ways[0]]), mujoco.MjData(model)
    seen = []
    for coordinate in (0.0, 1.0):
        data.qpos[qpos] = coordinate
        mujoco.mj_kinematics(model, data)
        seen.append(float((data.site_xpos if site else data.xpos)[of, component]))
    gear = seen[1] - seen[0]
    return (qpos, seen[0], gear) if abs(gear) > _ALONG else None


def output_channel(model: mujoco.MjModel, row: OutputRow, sensor: str, where: str) -> OutputChannel:
    """What a row of the map's outputs measures, read by the sensor of `sensor_of`.

    Raises:
        GapInputError: a unit or a component that does not fit, or a sensor that no recording can be compared with.
    """
    index = find(model, Obj.mjOBJ_SENSOR, sensor, "sensor", where)
    kind, dim, address = int(model.sensor_type[index]), int(model.sensor_dim[index]), int(model.sensor_adr[index])
    target = int(model.sensor_objid[index])
    component, euler, quantities = 0, -1, _SENSOR_QUANTITIES.get(kind, ())
    qpos = dof = -1
    gear, subsystem = 1.0, sensor
    if kind in (Sens.mjSENS_JOINTPOS, Sens.mjSENS_JOINTVEL, Sens.mjSENS_JOINTACTFRC):
        joint = target
    elif kind in (Sens.mjSENS_ACTUATORPOS, Sens.mjSENS_ACTUATORVEL) and (
        model.actuator_trntype[target] == mujoco.mjtTrn.mjTRN_JOINT
    ):
        joint, gear = int(model.actuator_trnid[target, 0]), float(model.actuator_gear[target, 0])
    else:
        joint = -1
    if joint >= 0:
        hinge = model.jnt_type[joint] == _HINGE
        if kind in (Sens.mjSENS_JOINTPOS, Sens.mjSENS_ACTUATORPOS):
            quantities, qpos = (("angle",) if hinge else ("length",)), int(model.jnt_qposadr[joint])
        elif kind in (Sens.mjSENS_JOINTVEL, Sens.mjSENS_ACTUATORVEL):
            quantities = ("angular_velocity",) if hinge else ("velocity",)
            dof = int(model.jnt_dofadr[joint])
        else:
            quantities = ("torque",) if hinge else ("force",)
        subsystem = model_names(model, Obj.mjOBJ_JOINT)[joint]
    elif kind in (Sens.mjSENS_ACTUATORFRC,):
        subsystem = model_names(model, Obj.mjOBJ_ACTUATOR)[target]
    elif kind in (Sens.mjSENS_TENDONPOS, Sens.mjSENS_TENDONVEL, Sens.mjSENS_TENDONACTFRC):
        subsystem = model_names(model, Obj.mjOBJ_TENDON)[target]
    elif sensor.startswith("gap:"):
        subsystem = sensor.split(":")[2]
    if not quantities:
        raise GapInputError(f"{where}: sensor {sensor!r} is of a type that cannot be compared with a recording")
    if row.component in _EULER:
        if kind != Sens.mjSENS_FRAMEQUAT:
            raise GapInputError(f"{where}: {row.component} needs an orientation")
        euler, quantities = _EULER.index(row.component), ("angle",)
    elif dim > 1:
        valid = _QUATERNION if dim == 4 else _COMPONENTS
        if row.component not in valid:
            raise GapInputError(
                f"{where}: sensor {sensor!r} has {dim} values; component must be one of {', '.join(valid)}"
            )
        component = valid[row.component]
        address += component
    elif row.component is not None:
        raise GapInputError(f"{where}: sensor {sensor!r} has one value; component must be left out")
    origin, rail = 0.0, _rail(model, index, component) if kind == Sens.mjSENS_FRAMEPOS else None
    if rail is not None:
        qpos, origin, gear = rail
    scale, quantity = factor(row.unit, quantities, where)
    return OutputChannel(
        name=row.column,
        column=row.column,
        quantity=quantity,
        unit=SI_UNITS[quantity],
        scale=row.sign * scale,
        address=address,
        sensor=sensor,
        sensor_type=kind,
        component=component,
        euler=euler,
        qpos=qpos,
        dof=dof,
        gear=gear,
        origin=origin,
        subsystem=subsystem,
        part=row.component or "",
        resolution=abs(scale) * (row.resolution or 0.0),
    )
