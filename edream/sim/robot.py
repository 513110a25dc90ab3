"""A robot: its MJCF, the joints that are commanded and recorded, and where its end effector is."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path, PurePosixPath

import mujoco

from edream.core.effect import MOTOR_SUFFIX
from edream.core.errors import EdreamError, unknown_name
from edream.sim.includes import merged

MAX_BYTES = 64 * 2**20
JOINT_TRANSMISSIONS = (int(mujoco.mjtTrn.mjTRN_JOINT), int(mujoco.mjtTrn.mjTRN_JOINTINPARENT))
HINGE_OR_SLIDE = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
LINK_SUFFIX = "_link"


@dataclass(frozen=True, eq=False)
class RobotModel:
    """A MuJoCo model of a robot, held as text so that it can be hashed, edited and written anywhere.

    Attributes:
        name: what reports call it.
        mjcf: the MJCF (or URDF) as text, with every include resolved.
        assets: mesh and texture files that the text names, file name -> bytes.
        site: name of the end-effector site, or None for the last body of the chain.
        recorded: the joints that recordings are about, where the model drives more than these; empty for all.
        clear: whether nothing touches in the recordings, so that searches may leave contacts out; see `edream.sim.touch`.
        step: the simulator's time step [s] where it is another than the text says; see `edream.diagnosis.steps`.
        timed: whether a command takes effect at its own time, also between steps, as searches have it; else at the next step, as in
            any plain loop.
    """

    name: str
    mjcf: str
    assets: Mapping[str, bytes] = field(default_factory=dict)
    site: str | None = None
    recorded: tuple[str, ...] = ()
    clear: bool = False
    step: float | None = None
    timed: bool = False

    @property
    def published(self) -> "RobotModel":
        """The robot with the time step that its text says."""
        return self if self.step is None else replace(self, step=None)

    def spec(self) -> mujoco.MjSpec:
        """A fresh, editable `mujoco.MjSpec` of this robot; links without a name are called after their joint, `<joint>_link`.

        Raises:
            EdreamError: MuJoCo cannot parse the text.
        """
        try:
            spec = mujoco.MjSpec.from_string(self.mjcf, assets=dict(self.assets))
        except ValueError as error:
            raise EdreamError(f"Robot {self.name!r}: MuJoCo cannot read its model: {_one_line(error)}") from error
        taken = {body.name for body in spec.bodies}
        for joint in spec.joints:
            if joint.name and not joint.parent.name and joint.name + LINK_SUFFIX not in taken:
                joint.parent.name = joint.name + LINK_SUFFIX
        if self.step is not None:
            spec.option.timestep = self.step
        return spec

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model, as published. Treat as read only.

        Raises:
            EdreamError: MuJoCo cannot compile it.
        """
        return self._compiled[0]

    @property
    def body_numbers(self) -> tuple[int, ...]:
        """For each body of `spec()`, in its order, the number that it has in `model`."""
        return self._compiled[1]

    @cached_property
    def _compiled(self) -> tuple[mujoco.MjModel, tuple[int, ...]]:
        spec = self.spec()
        try:
            model = spec.compile()
        except ValueError as error:
            raise EdreamError(f"Robot {self.name!r}: MuJoCo cannot compile its model: {_one_line(error)}") from error
        return model, tuple(int(body.id) for body in spec.bodies)

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the recorded joints, in the order of the actuators that drive them, (J,).

        Actuators of anything but a hinge or a slide, such as a gripper's tendon, take no commands here and stay at 0.

        Raises:
            EdreamError: no actuator drives a hinge or slide joint, or none drives one of `recorded`.
        """
        driven = self._driven()
        for name in self.recorded:
            if name not in driven:
                raise unknown_name("driven joint (named in robot.joints)", name, driven)
        return tuple(name for name in driven if not self.recorded or name in self.recorded)

    def _driven(self) -> list[str]:
        model = self.model
        names = []
        every = {model.joint(number).name for number in range(model.njnt)}
        for actuator in range(model.nactuator):
            if not model.actuator_ctrlnum[actuator]:
                continue  # a passive device (cogging, bristle friction) takes no command
            joint = int(model.actuator_trnid[actuator, 0])
            if int(model.actuator_trntype[actuator]) not in JOINT_TRANSMISSIONS or int(model.jnt_type[joint]) not in HINGE_OR_SLIDE:
                continue
            name = model.joint(joint).name
            link = name.removesuffix(MOTOR_SUFFIX)  # a motor behind a gear with play or give moves the link's joint
            names.append(link if link in every else name)
        if not names:
            raise EdreamError(
                f"Robot {self.name!r} has no actuator on a hinge or slide joint; expected one for each recorded joint, such as a "
                "position servo."
            )
        return names

    def joint_index(self, name: str) -> int:
        """Column of a joint.

        Raises:
            EdreamError: the robot has no such actuated joint.
        """
        if name not in self.joints:
            raise unknown_name("joint", name, self.joints)
        return self.joints.index(name)


def load_robot(path: Path, name: str | None = None, site: str | None = None, recorded: Sequence[str] = ()) -> RobotModel:
    """Read a robot from an MJCF or URDF file, with its includes and assets.

    No file outside the model's own folder (or its parent's `assets`/`meshes` folders) is opened.

    Args:
        path: the MJCF or URDF file.
        name: what reports call it; the file's stem where None.
        site: end-effector site, or None to take the last body.
        recorded: the joints that recordings are about; empty for all that are driven.

    Raises:
        EdreamError: the file does not exist, is too large, leaves its folder or is not a MuJoCo model, or a joint is not driven.
    """
    path = Path(path)
    if not path.is_file():
        raise EdreamError(f"There is no robot model at {path}. Expected an MJCF or URDF file; give it as robot.mjcf=PATH.")
    if path.stat().st_size > MAX_BYTES:
        raise EdreamError(f"Robot model {path} has {path.stat().st_size} bytes; expected at most {MAX_BYTES}.")
    root = path.resolve().parent
    text = merged(_decode(path.read_bytes(), path), path, lambda name: _decode(_inside(name, root, path), path))
    flat = RobotModel(name or path.stem, text, _asset_files(text, root, path), site, tuple(recorded))
    if site is not None and site not in [s.name for s in flat.spec().sites]:
        raise unknown_name(f"site in {path.name}", site, [s.name for s in flat.spec().sites])
    return flat


def _decode(data: bytes, path: Path) -> str:
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise EdreamError(f"Robot model {path} is not text: byte {error.start} is not UTF-8. Expected MJCF or URDF.") from error
    if text.startswith("version https://git-lfs"):
        raise EdreamError(f"{path} is a Git LFS pointer, not the model itself. Run 'git lfs pull' where it came from.")
    return text


def _inside(name: str, root: Path, path: Path) -> bytes:
    """A file that a model names, read from inside `root`."""
    target = (root / name).resolve()
    if not target.is_relative_to(root):
        raise EdreamError(f"Robot model {path} names {name!r}, which lies outside its own folder; it was not opened.")
    if not target.is_file():
        raise EdreamError(f"Robot model {path} names {name!r}, which does not exist at {target}.")
    if target.stat().st_size > MAX_BYTES:
        raise EdreamError(f"{target}, named by {path}, has {target.stat().st_size} bytes; expected at most {MAX_BYTES}.")
    return target.read_bytes()


def _asset_files(text: str, root: Path, path: Path) -> dict[str, bytes]:
    """Every mesh, height field, skin and texture that the text names: path beside the model -> bytes."""
    found: dict[str, bytes] = {}
    for tag, attribute in (("mesh", "meshdir"), ("hfield", "meshdir"), ("skin", "meshdir"), ("texture", "texturedir")):
        named = re.search(rf'\b{attribute}\s*=\s*["\']([^"\']*)["\']', text) or re.search(
            r'\bassetdir\s*=\s*["\']([^"\']*)["\']', text
        )
        folder = PurePosixPath(named.group(1) if named else "")
        for name in re.findall(rf'<{tag}\b[^>]*?\bfile\s*=\s*["\']([^"\']+)["\']', text):
            relative = str(folder / name.removeprefix("package://"))
            found[relative] = _inside(relative, root, path)
    return found


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def joint_groups(robot: RobotModel, ties: Sequence[Sequence[str]], counted: Sequence[str] = ()) -> list[tuple[str, ...]]:
    """The robot's joints in groups that share their numbers; [["all"]] is one group of all, and joints in no group stand alone.

    Args:
        counted: joints whose errors count, all where empty. A group without one of them is left out: nothing would say what its
            numbers are, and a fit would take them anywhere.

    Raises:
        EdreamError: a joint does not exist or stands in two groups.
    """
    if [list(group) for group in ties] == [["all"]]:
        return [robot.joints]
    for joint in (*counted, *(joint for group in ties for joint in group)):
        robot.joint_index(joint)
    tied = [joint for group in ties for joint in group]
    twice = sorted({joint for joint in tied if tied.count(joint) > 1})
    if twice:
        raise EdreamError(f"Joint {twice[0]!r} stands in two groups of ties; expected one at most.")
    groups = [tuple(group) for group in ties] + [(joint,) for joint in robot.joints if joint not in tied]
    told = [group for group in groups if not counted or set(group) & set(counted)]
    return sorted(told, key=lambda group: robot.joints.index(group[0]))
