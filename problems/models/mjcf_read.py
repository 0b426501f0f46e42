"""Files of MuJoCo and URDF, compiled: meshes that are not there, and remarks of MuJoCo."""

from __future__ import annotations

import os
import re
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from problems.models.mjcf_objects import load_mujoco
from problems.plain_text import said
from problems.spec import SpecError

#: Endings of meshes that MuJoCo reads.
_MESHES = (".stl", ".obj", ".msh")


def read(path: Path, meshes: Path | None) -> tuple[Any, list[str]]:
    """Return the compiled model of a file, and sentences on what is not as in the file.

    A mesh shows and touches; the mass of its body is stated in the file, or the mesh is needed.
    Where its file is not there, as behind ``package://``, it is left out.

    Parameters
    ----------
    path
        File of MuJoCo or URDF.
    meshes
        Folder in which meshes and textures are looked for, too.

    Raises
    ------
    SpecError
        If MuJoCo does not take the file, or a mesh is not there that gives a body its mass.
    """
    mujoco, notes = load_mujoco(), []
    with _remarks() as remarks:
        try:
            spec = mujoco.MjSpec.from_file(str(path))
            if lost := _without_lost(spec, path, meshes):
                names = ", ".join(dict.fromkeys(lost))
                notes.append(f"Meshes and textures are left out that are not there ({names}).")
            compiled = spec.compile()
        except SpecError:
            raise
        except (ValueError, RuntimeError, OSError) as error:
            raise SpecError(f"MuJoCo cannot read {path}: {said(error)}") from None
    return compiled, [*notes, *remarks]


@contextmanager
def _remarks() -> Iterator[list[str]]:
    """The warnings of MuJoCo as sentences, each once.

    It gives them to a callback, to Python, or writes them to the standard error stream.
    """
    mujoco, found = load_mujoco(), []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(found.append)
    try:
        with (
            warnings.catch_warnings(record=True) as told,
            tempfile.TemporaryFile() as written,
            _standard_error(written.fileno()),
        ):
            warnings.simplefilter("always")
            try:
                yield found
            finally:
                written.seek(0)
                lines = written.read().decode(errors="replace").splitlines()
                found += [str(warning.message) for warning in told] + [*filter(None, lines)]
    finally:
        mujoco.set_mju_user_warning(before)
        texts = (" ".join(text.split()).removeprefix("WARNING: ").rstrip(".") for text in found)
        found[:] = dict.fromkeys(f"MuJoCo warns: {text}." for text in texts)


@contextmanager
def _standard_error(file: int) -> Iterator[None]:
    """The standard error stream of the process, also of C, goes to a file."""
    kept = os.dup(2)
    os.dup2(file, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)


def _without_lost(spec: Any, path: Path, root: Path | None) -> list[str]:
    """Leave meshes and textures out whose files are not there, and return their names."""
    mujoco, lost = load_mujoco(), []
    for mesh in [*spec.meshes]:
        if mesh.file and not _found(spec, mesh, spec.meshdir, path, root, _MESHES):
            lost.append(mesh.file)
            for geom in spec.geoms:
                if geom.meshname == mesh.name:
                    _stand_in(spec, geom, path, mesh.file)
            spec.delete(mesh)
    for texture in [*spec.textures]:
        if texture.file and not _found(spec, texture, spec.texturedir, path, root):
            lost.append(texture.file)
            texture.file, texture.builtin = "", mujoco.mjtBuiltin.mjBUILTIN_FLAT
            texture.width = texture.height = 1
    return lost


def _found(
    spec: Any, asset: Any, folder: str, path: Path, root: Path | None, endings: Any = ""
) -> bool:
    """Whether the file of an asset is there; it is named anew if it is in the root."""
    if not asset.file.lower().endswith(endings):
        return False
    if asset.file in spec.assets or (path.parent / folder / asset.file).is_file():
        return True
    if root is not None:
        # package://robot/meshes/arm.stl: the root may hold robot, meshes or arm.stl.
        parts = Path(re.sub(r"^\w+://", "", asset.file)).parts
        for k in range(len(parts)):
            place = root.resolve().joinpath(*parts[k:])
            if place.is_file():
                asset.file = str(place)
                return True
    return False


def _stand_in(spec: Any, geom: Any, path: Path, file: str) -> None:
    """Make a small ball without mass of a geometry that is a mesh."""
    mujoco = load_mujoco()
    always = spec.compiler.inertiafromgeom == mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    stated = geom.parent.explicitinertial and not always
    # The links of a URDF state their masses, or have none.
    if not (stated or path.suffix == ".urdf" or geom.parent == spec.worldbody):
        raise SpecError(
            f"{path}: the mesh {file} is not there, which gives the body {geom.parent.name!r} its "
            f"mass; name its folder: stepbench new problem NAME --from FILE --meshes FOLDER."
        )
    geom.meshname, geom.mass = "", 0.0
    geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [0.01, 0.0, 0.0]
