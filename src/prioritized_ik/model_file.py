"""MuJoCo models of files: MJCF, and URDF with what it does not say itself."""

from pathlib import Path
from xml.etree import ElementTree

import mujoco

from prioritized_ik.errors import ModelError
from prioritized_ik.files import advising

#: How a URDF is read: fixed links, such as a tool's, stay bodies to be named; links without mass get next to none; paths
#: are relative to the file. Its visual shapes are kept where it has no others: many are in formats that MuJoCo cannot read.
URDF = {
    "fusestatic": "false",
    "boundmass": "1e-6",
    "boundinertia": "1e-9",
    "balanceinertia": "true",
    "strippath": "false",
}


def model_of(file: Path) -> mujoco.MjModel:
    """Return the model of an MJCF or URDF file, told apart by what is in it.

    Raises:
        ModelError: no such file, one that MuJoCo cannot read, or a URDF with xacro or `package://` paths.
    """
    if not file.is_file():
        raise ModelError(f"there is no file {str(file)!r}; expected an MJCF (.xml) or URDF (.urdf) file.")
    with advising("read", file, ModelError, "choose a file that can be read"):
        content = file.read_bytes()
    try:
        root = _urdf_in(file, content)
        if root is None:
            return mujoco.MjModel.from_xml_path(str(file))
        _check_urdf(file, content.decode(errors="replace"))
        spec = mujoco.MjSpec.from_string(_completed(root))
        spec.modelfiledir = str(file.parent)
        return spec.compile()
    except ModelError:
        raise
    except (ValueError, ElementTree.ParseError) as error:
        raise ModelError(f"MuJoCo cannot read {file.name}: {error}") from error


def _urdf_in(file: Path, content: bytes) -> ElementTree.Element | None:
    """Return the URDF in a file's content, None of MJCF, which MuJoCo reads more leniently than others."""
    try:
        root = ElementTree.fromstring(content)
    except ElementTree.ParseError:
        if file.suffix == ".urdf":
            raise
        return None
    return root if root.tag == "robot" else None


def _check_urdf(file: Path, text: str) -> None:
    if "package://" in text:
        raise ModelError(
            f"{file.name} has package:// paths, which only ROS can resolve; replace them by paths relative to the file."
        )
    if "<xacro:" in text or "${" in text:
        raise ModelError(f"{file.name} has xacro in it; expand it first: xacro {file.name} > robot.urdf.")


def _completed(root: ElementTree.Element) -> str:
    """Return a URDF with what MuJoCo is to make of it, unless its own `<mujoco><compiler>` says otherwise."""
    extension = root.find("mujoco")
    if extension is None:
        extension = ElementTree.Element("mujoco")
        root.insert(0, extension)
    compiler = extension.find("compiler")
    if compiler is None:
        compiler = ElementTree.SubElement(extension, "compiler")
    collides = next(root.iter("collision"), None) is not None
    for name, value in (URDF | {"discardvisual": str(collides).lower()}).items():
        compiler.attrib.setdefault(name, value)
    return ElementTree.tostring(root, encoding="unicode")
