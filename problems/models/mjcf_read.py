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

from problems.models.mjcf_parts import load_mujoco
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
            if lost := [*_without_lost(spec, path, meshes)]:
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

    It gives them to a callback, to Python, or writes them to the standard error stream of C.
    """
    mujoco, found, stream = load_mujoco(), [], os.dup(2)
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(found.append)
    with (
        warnings.catch_warnings(record=True, action="always") as told,
        tempfile.TemporaryFile() as written,
    ):
        os.dup2(written.fileno(), 2)
        try:
            yield found
        finally:
            os.dup2(stream, 2)
            os.close(stream)
            mujoco.set_mju_user_warning(before)
            written.seek(0)
            lines = written.read().decode(errors="replace").splitlines()
            found += [str(warning.message) for warning in told] + [*filter(None, lines)]
            texts = (" ".join(text.split()).removeprefix("WARNING: ") for text in found)
            found[:] = dict.fromkeys(f"MuJoCo warns: {text.rstrip('.')}." for text in texts)


def _without_lost(spec: Any, path: Path, root: Path | None) -> Iterator[str]:
    """Leave meshes and textures out whose files are not there, and give their names."""
    mujoco = load_mujoco()
    for mesh in [*spec.meshes]:
        if mesh.file and not _found(spec, mesh, spec.meshdir, path, root, _MESHES):
            yield mesh.file
            for geom in spec.geoms:
                if geom.meshname == mesh.name:
                    _check_mass(spec, geom, path, mesh.file)
                    # A small ball without mass stands in for it: it may touch.
                    geom.meshname, geom.mass = "", 0.0
                    geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [0.01, 0.0, 0.0]
            spec.delete(mesh)
    for texture in spec.textures:
        if texture.file and not _found(spec, texture, spec.texturedir, path, root):
            yield texture.file
            texture.file, texture.builtin = "", mujoco.mjtBuiltin.mjBUILTIN_FLAT
            texture.width = texture.height = 1


def _found(
    spec: Any, asset: Any, folder: str, path: Path, root: Path | None, endings: Any = ""
) -> bool:
    """Whether the file of an asset is there; it is named anew if it is in the root."""
    if not asset.file.lower().endswith(endings):
        return False
    if asset.file in spec.assets or (path.parent / folder / asset.file).is_file():
        return True
    # package://robot/meshes/arm.stl: the root may hold robot, meshes or arm.stl.
    parts = Path(re.sub(r"^\w+://", "", asset.file)).parts
    for k in range(len(parts) if root else 0):
        place = Path(root or "").resolve().joinpath(*parts[k:])
        if place.is_file():
            asset.file = str(place)
            return True
    return False


def _check_mass(spec: Any, geom: Any, path: Path, file: str) -> None:
    """Refuse that a mesh is not there which gives a body its mass."""
    always = load_mujoco().mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    stated = geom.parent.explicitinertial and spec.compiler.inertiafromgeom != always
    # The links of a URDF state their masses, or have none.
    if not (stated or path.suffix == ".urdf" or geom.parent == spec.worldbody):
        raise SpecError(
            f"{path}: the mesh {file} is not there, which gives the body {geom.parent.name!r} its "
            f"mass; name its folder: stepbench new problem NAME --from FILE --meshes FOLDER."
        )
