"""Files that scripts make: meshes and URDF."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from pathlib import Path

import mujoco
import numpy as np
import pytest

import nermo_description
from nermo_description.model import build_robot
from nermo_description.scripts import export_urdf, generate_meshes
from nermo_description.urdf import to_urdf

PACKAGE = Path(nermo_description.__file__).parent


@pytest.fixture(scope="session")
def meshes() -> dict[str, bytes]:
    return generate_meshes.generate()


def test_meshes_are_what_the_script_makes(meshes):
    shipped = {path.name: path.read_bytes() for path in (PACKAGE / "meshes").glob("*.stl")}
    assert shipped == meshes
    assert sum(len(data) for data in meshes.values()) < 1_000_000


def test_meshes_are_closed(meshes):
    """Every edge belongs to two triangles, once in either direction."""
    for name, data in meshes.items():
        records = np.frombuffer(data[84:], dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("x", "<u2")])
        corners = [tuple(map(tuple, triangle)) for triangle in records["corners"].tolist()]
        edges = [(t[i], t[(i + 1) % 3]) for t in corners for i in range(3)]
        assert sorted(edges) == sorted((b, a) for a, b in edges), name


def test_mesh_script_checks_and_writes(tmp_path, capsys):
    assert generate_meshes.main(["--check"]) == 0
    assert generate_meshes.main(["--check", "--out", str(tmp_path)]) == 1
    assert "skull.stl" in capsys.readouterr().err
    assert generate_meshes.main(["--out", str(tmp_path)]) == 0
    assert generate_meshes.main(["--check", "--out", str(tmp_path)]) == 0


@pytest.fixture(scope="session")
def urdf(robot) -> tuple[mujoco.MjModel, ElementTree.Element]:
    model = build_robot(robot).compile()
    return model, ElementTree.fromstring(to_urdf(model))


def vector(element: ElementTree.Element | None, name: str) -> np.ndarray:
    assert element is not None
    return np.array([float(value) for value in element.attrib[name].split()])


def pose_of(origin: ElementTree.Element | None) -> np.ndarray:
    roll, pitch, yaw = vector(origin, "rpy")
    pose = np.eye(4)
    pose[:3, :3] = turn((0, 0, 1), yaw) @ turn((0, 1, 0), pitch) @ turn((1, 0, 0), roll)
    pose[:3, 3] = vector(origin, "xyz")
    return pose


def turn(axis, angle: float) -> np.ndarray:
    x, y, z = axis
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k


def test_urdf_is_a_tree_from_base_link(urdf):
    _, robot = urdf
    links = [link.attrib["name"] for link in robot.findall("link")]
    children = [joint.find("child").attrib["link"] for joint in robot.findall("joint")]
    assert len(set(links)) == len(links)
    assert sorted([*children, "base_link"]) == sorted(links)
    assert {"imu_link", "front_left_foot", "head_left_camera_optical"} <= set(links)


def test_urdf_moves_as_the_model_does(urdf):
    model, robot = urdf
    data = mujoco.MjData(model)
    random = np.random.default_rng(3)
    angles = {}
    for joint in range(model.njnt):
        if model.joint(joint).name != "root":
            low, high = model.jnt_range[joint]
            data.qpos[model.jnt_qposadr[joint]] = angles[model.joint(joint).name] = random.uniform(low, high)
    mujoco.mj_fwdPosition(model, data)
    poses = {"base_link": np.eye(4)}
    for joint in robot.findall("joint"):  # parents come first
        pose = poses[joint.find("parent").attrib["link"]] @ pose_of(joint.find("origin"))
        if joint.attrib["type"] == "revolute":
            pose[:3, :3] = pose[:3, :3] @ turn(vector(joint.find("axis"), "xyz"), angles.pop(joint.attrib["name"]))
        poses[joint.find("child").attrib["link"]] = pose
    assert not angles  # every joint of the model is in the URDF
    for body in range(2, model.nbody):
        name = model.body(body).name
        np.testing.assert_allclose(poses[name][:3, 3], data.xpos[body], atol=1e-7, err_msg=name)
        np.testing.assert_allclose(poses[name][:3, :3], data.xmat[body].reshape(3, 3), atol=1e-7, err_msg=name)
    np.testing.assert_allclose(poses["rear_left_foot"][:3, 3], data.site("rear_left_foot").xpos, atol=1e-7)
    # An optical frame looks along z; MuJoCo's camera along -z.
    np.testing.assert_allclose(
        poses["head_left_camera_optical"][:3, 2], -data.cam("head_left").xmat.reshape(3, 3)[:, 2], atol=1e-7
    )


def test_urdf_weighs_the_same_and_finds_its_meshes(urdf):
    model, robot = urdf
    masses = [float(mass.attrib["value"]) for mass in robot.iter("mass")]
    assert sum(masses) == pytest.approx(model.body_mass.sum())
    for mesh in robot.iter("mesh"):
        assert (PACKAGE / mesh.attrib["filename"].removeprefix("package://nermo_description/")).is_file()


def test_urdf_meshes_lie_where_the_model_has_them(urdf):
    """MuJoCo recentres meshes when it compiles; the first vertex of the file must come out at the same place."""
    model, robot = urdf
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    geom = next(
        g
        for g in range(model.ngeom)
        if model.geom_dataid[g] >= 0 and model.body(model.geom_bodyid[g]).name == "head_skull"
    )
    mesh = model.geom_dataid[geom]
    vertices = model.mesh_vert[model.mesh_vertadr[mesh] :][: model.mesh_vertnum[mesh]]
    placed = data.geom_xpos[geom] + vertices @ data.geom_xmat[geom].reshape(3, 3).T
    in_body = (placed - data.body("head_skull").xpos) @ data.body("head_skull").xmat.reshape(3, 3)
    link = next(link for link in robot.findall("link") if link.attrib["name"] == "head_skull")
    visual = next(v for v in link.findall("visual") if v.find("geometry/mesh") is not None)
    file = PACKAGE / visual.find("geometry/mesh").attrib["filename"].removeprefix("package://nermo_description/")
    records = np.frombuffer(file.read_bytes()[84:], dtype=[("n", "<f4", 3), ("corners", "<f4", (3, 3)), ("x", "<u2")])
    corners = records["corners"].reshape(-1, 3)
    pose = pose_of(visual.find("origin"))
    expected = corners @ pose[:3, :3].T + pose[:3, 3]
    np.testing.assert_allclose(in_body.min(axis=0), expected.min(axis=0), atol=1e-6)
    np.testing.assert_allclose(in_body.max(axis=0), expected.max(axis=0), atol=1e-6)


def test_shipped_urdf_is_the_model(robot, urdf):
    shipped = (Path(__file__).parents[1] / "urdf" / f"{robot.name}.urdf").read_text()
    assert shipped == to_urdf(urdf[0])


def test_urdf_script(tmp_path, capsys):
    out = tmp_path / "mouse.urdf"
    assert export_urdf.main(["nermo_lite", "--out", str(out)]) == 0
    assert ElementTree.parse(out).getroot().attrib["name"] == "nermo_lite"
    assert export_urdf.main(["nermo_light"]) == 1
    assert "nermo_lite" in capsys.readouterr().err
