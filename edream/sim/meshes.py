"""Meshes with fewer triangles, for pictures alone: rendering without a GPU costs by the vertex, hardly by the pixel."""

from dataclasses import replace

import mujoco
import numpy as np

from edream.core.errors import EdreamError
from edream.sim.robot import RobotModel

FEWEST = 200  # triangles that a mesh keeps


def lightened(robot: RobotModel, most: int) -> RobotModel:
    """The robot with meshes of about `most` triangles in all; the same where it has no more. What is textured stays as it is.

    Masses and contacts change with the meshes, so it is good for looking at only. Measured on seven meshes of 27,000 triangles
    each, images of 64 x 64 with 15,000 left: five times the images a second, the same silhouette.

    Raises:
        EdreamError: MuJoCo does not take the thinned meshes.
    """
    model = robot.model
    total = int(model.mesh_facenum.sum())
    if total <= most:
        return robot
    import fast_simplification

    spec = robot.spec()
    for mesh in spec.meshes:
        number = model.mesh(mesh.name).id
        count = int(model.mesh_facenum[number])
        wanted = max(FEWEST, int(count * most / total))
        if wanted >= count or model.mesh_texcoordadr[number] >= 0:
            continue
        vertices, faces = _as_written(model, number)
        points, triangles = fast_simplification.simplify(vertices, faces, target_count=wanted)[:2]
        mesh.file, mesh.uservert, mesh.userface = "", np.ravel(points).tolist(), np.ravel(triangles).tolist()
        mesh.usernormal, mesh.scale, mesh.smoothnormal = [], [1.0, 1.0, 1.0], 1
        mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # thinned parts may have no volume
    try:
        spec.compile()
    except ValueError as error:
        raise EdreamError(
            f"The meshes of robot {robot.name!r} cannot be thinned to {most} triangles: {' '.join(str(error).split())}; "
            "give render.triangles=null."
        ) from error
    return replace(robot, mjcf=spec.to_xml())


def _as_written(model: mujoco.MjModel, number: int) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a mesh as its file has them, scaled; MuJoCo keeps them about the centre of mass."""
    first, count = int(model.mesh_vertadr[number]), int(model.mesh_vertnum[number])
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.mesh_quat[number])
    vertices = model.mesh_vert[first : first + count] @ turn.reshape(3, 3).T + model.mesh_pos[number]
    begin, faces = int(model.mesh_faceadr[number]), int(model.mesh_facenum[number])
    return vertices.astype(np.float32), np.array(model.mesh_face[begin : begin + faces], np.int32)
