"""A robot: its MJCF, the joints that are commanded and recorded, and where its end effector is."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path, PurePosixPath

import mujoco

from edream.core.effect import MOTOR_SUFFIX
from edream.core.errors import EdreamError, unknown_name

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
    """

    name: str
    mjcf: str
    assets: Mapping[str, bytes] = field(default_factory=dict)
    site: str | None = None
    recorded: tuple[str, ...] = ()

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
        return spec

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The compiled model, as published. Treat as read only.

        Raises:
            EdreamError: MuJoCo cannot compile it.
        """
        try:
            return self.spec().compile()
        except ValueError as error:
            raise EdreamError(f"Robot {self.name!r}: MuJoCo cannot compile its model: {_one_line(error)}") from error

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
    text = _read_text(path)
    includes = _files(text, root, path, tag="include")
    for depth in range(16):
        nested = {
            k: v for inner in list(includes.values()) for k, v in _files(_decode(inner, path), root, path, tag="include").items()
        }
        if nested.keys() <= includes.keys():
            break
        includes |= nested
        if depth == 15:
            raise EdreamError(f"Robot model {path}: its includes are nested more than 16 deep.")
    robot_name = name or path.stem
    texts = [text, *(_decode(inner, path) for inner in includes.values())]
    assets: dict[str, bytes] = dict(includes)
    for one in texts:
        assets |= _asset_files(one, texts, root, path)
    flat = RobotModel(robot_name, text, assets, site, tuple(recorded))
    if includes:
        spec = flat.spec()
        spec.compile()
        flat = replace(flat, mjcf=spec.to_xml(), assets={k: v for k, v in assets.items() if k not in includes})
    if site is not None and site not in [s.name for s in flat.spec().sites]:
        raise unknown_name(f"site in {path.name}", site, [s.name for s in flat.spec().sites])
    return flat


def _read_text(path: Path) -> str:
    return _decode(path.read_bytes(), path)


def _decode(data: bytes, path: Path) -> str:
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise EdreamError(f"Robot model {path} is not text: byte {error.start} is not UTF-8. Expected MJCF or URDF.") from error
    if text.startswith("version https://git-lfs"):
        raise EdreamError(f"{path} is a Git LFS pointer, not the model itself. Run 'git lfs pull' where it came from.")
    return text


def _files(text: str, root: Path, path: Path, tag: str, folder: str = "") -> dict[str, bytes]:
    """The files that `<tag ... file="...">` names, read from inside `root`."""
    found = {}
    for name in re.findall(rf'<{tag}\b[^>]*?\bfile\s*=\s*["\']([^"\']+)["\']', text):
        relative = PurePosixPath(folder) / name.removeprefix("package://")
        target = (root / relative).resolve()
        if not target.is_relative_to(root):
            raise EdreamError(f"Robot model {path} names {name!r}, which lies outside its own folder; it was not opened.")
        if not target.is_file():
            raise EdreamError(f"Robot model {path} names {name!r}, which does not exist at {target}.")
        if target.stat().st_size > MAX_BYTES:
            raise EdreamError(f"{target}, named by {path}, has {target.stat().st_size} bytes; expected at most {MAX_BYTES}.")
        found[str(relative) if tag != "include" else name] = target.read_bytes()
    return found


def _asset_files(text: str, texts: list[str], root: Path, path: Path) -> dict[str, bytes]:
    joined = "\n".join(texts)
    found: dict[str, bytes] = {}
    for tag, attribute in (("mesh", "meshdir"), ("hfield", "meshdir"), ("skin", "meshdir"), ("texture", "texturedir")):
        named = re.search(rf'\b{attribute}\s*=\s*["\']([^"\']*)["\']', joined) or re.search(
            r'\bassetdir\s*=\s*["\']([^"\']*)["\']', joined
        )
        found |= _files(text, root, path, tag, folder=named.group(1) if named else "")
    return found


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def joint_groups(robot: RobotModel, ties: Sequence[Sequence[str]]) -> list[tuple[str, ...]]:
    """The robot's joints in groups that share their numbers; [["all"]] is one group of all, and joints in no group stand alone.

    Raises:
        EdreamError: a joint does not exist or stands in two groups.
    """
    if [list(group) for group in ties] == [["all"]]:
        return [robot.joints]
    for joint in (joint for group in ties for joint in group):
        robot.joint_index(joint)
    tied = [joint for group in ties for joint in group]
    twice = sorted({joint for joint in tied if tied.count(joint) > 1})
    if twice:
        raise EdreamError(f"Joint {twice[0]!r} stands in two groups of ties; expected one at most.")
    groups = [tuple(group) for group in ties] + [(joint,) for joint in robot.joints if joint not in tied]
    return sorted(groups, key=lambda group: robot.joints.index(group[0]))
