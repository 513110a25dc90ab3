"""A robot without what only shows: no visual geoms, no meshes and textures for them, so that it compiles and steps quickly."""

from collections.abc import Collection

import mujoco
import numpy as np

from edream.sim.robot import RobotModel

WRAPPED = (int(mujoco.mjtWrap.mjWRAP_SPHERE), int(mujoco.mjtWrap.mjWRAP_CYLINDER))
GEOM = int(mujoco.mjtObj.mjOBJ_GEOM)


def lean_spec(robot: RobotModel, kept: Collection[str] = ()) -> mujoco.MjSpec:
    """The robot's spec without geoms that touch nothing; it moves as the whole one does, number for number.

    Geoms that can collide stay, unless the robot is marked as clear. Masses are those that MuJoCo took from all geoms. A model in
    which something else hangs on its geoms stays as it is. Geoms named in `kept`, such as those that an effect acts on, stay.
    """
    spec, model = robot.spec(), robot.model
    if _needs_geoms(spec, model):
        return spec
    for body, number in zip(spec.bodies, robot.body_numbers, strict=True):
        if number > 0:
            _hold_inertia(body, model, number)
    spec.compiler.inertiafromgeom = int(mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE)
    spec.compiler.settotalmass = -1.0
    for geom in list(spec.geoms):
        if geom.name not in kept and (robot.clear or not (geom.contype or geom.conaffinity)):
            spec.delete(geom)
    for drawn in (*spec.geoms, *spec.sites, *spec.tendons):
        drawn.material = ""
    used = {geom.meshname for geom in spec.geoms}
    unused = [mesh for mesh in spec.meshes if mesh.name not in used]
    for asset in (*unused, *spec.materials, *spec.textures):
        spec.delete(asset)
    return spec


def _needs_geoms(spec: mujoco.MjSpec, model: mujoco.MjModel) -> bool:
    """Whether forces, sensors or other elements refer to geoms, or bodies are not what the text says they are."""
    sensed = (model.sensor_objtype == GEOM) | (model.sensor_reftype == GEOM)
    return bool(
        spec.compiler.fusestatic
        or model.npair
        or model.nskin
        or model.nflex
        or model.nplugin
        or model.opt.density
        or model.opt.viscosity
        or sensed.any()
        or np.isin(model.wrap_type, WRAPPED).any()
    )


def _hold_inertia(body: mujoco.MjsBody, model: mujoco.MjModel, number: int) -> None:
    body.explicitinertial = True
    body.mass = model.body_mass[number]
    body.ipos, body.iquat = model.body_ipos[number], model.body_iquat[number]
    body.inertia = model.body_inertia[number]
    body.fullinertia = np.full(6, np.nan)
    body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
