"""Compiled time loops that are called with few arguments."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from integrators.native import klu
from problems.exported_programs import exported
from problems.runtime import jax, jnp, known_options

if TYPE_CHECKING:
    from jax import Array
    from jaxtyping import Float


class Kernel:
    """A compiled time loop; its many small arguments travel as one array.

    Each array that goes into a compiled program or comes back costs as much as a step.

    Parameters
    ----------
    loop
        Traceable function of (parameters, numbers, start, time, *wanted); ``wanted`` selects the
        rows to keep.
    about
        All that decides the loop, so that its trace can be kept; None if it cannot.
    """

    def __init__(self, loop: Callable, about: tuple | None = None) -> None:
        self._unpack: Callable | None = None
        self._form: Any = None
        self._types: tuple[str, ...] = ()
        self._shapes: Any = None

        def run(packed: Array, *wanted: Any) -> Any:
            return loop(*self.unpacked(packed), *wanted)

        self.compiled = (
            exported(run, lambda: (about, str(self._form), self._types)) if about else jax.jit(run)
        )
        self._run = run

    def pack(self, *arguments: Any) -> Float[Array, " n"]:
        """Pack parameters, numbers, start and time: floats, and integers below 2^53."""
        leaves, tree = jax.tree.flatten(arguments)
        leaves = [np.asarray(leaf) for leaf in leaves]
        cuts = np.cumsum([leaf.size for leaf in leaves])[:-1]

        def unpack(packed: Array) -> Any:
            parts = jnp.split(packed, cuts)
            return jax.tree.unflatten(
                tree,
                [
                    part.reshape(leaf.shape).astype(leaf.dtype)
                    for part, leaf in zip(parts, leaves, strict=True)
                ],
            )

        form = tree, tuple(leaf.shape for leaf in leaves)
        if self._form not in (None, form):
            raise RuntimeError(
                "A kernel takes arguments of one form; another needs its own program."
            )
        self._form, self._unpack = form, self._unpack or unpack
        self._types = self._types or tuple(leaf.dtype.str for leaf in leaves)
        return jnp.asarray(np.concatenate([leaf.ravel().astype(float) for leaf in leaves]))

    def unpacked(self, packed: Float[Array, " n"]) -> Any:
        """The arguments that were packed; RuntimeError if this kernel has packed none yet."""
        if self._unpack is None:
            raise RuntimeError("A kernel unpacks only arguments that it has packed.")
        return self._unpack(packed)

    def shapes(self, packed: Float[Array, " n"]) -> Any:
        """The shapes of the arguments that were packed."""
        self._shapes = self._shapes or jax.eval_shape(self.unpacked, packed)
        return self._shapes

    def __call__(self, packed: Float[Array, " n"], *wanted: Any) -> Any:
        return self.compiled(packed, *wanted)

    @cached_property
    def _many(self) -> Callable:
        # Many runs do the same arithmetic side by side: use the widest registers.
        wide = known_options(xla_cpu_prefer_vector_width=512)
        return jax.jit(jax.vmap(self._run), compiler_options=wide)

    def batched(self, packed: Float[np.ndarray, "k n"], *wanted: Any) -> Any:
        """Run many runs in one program: every argument has one more axis in front."""
        return self._many(packed, *wanted)

    @property
    def compilations(self) -> int:
        """Number of compiled programs; one serves all schemes, steps and parameters."""
        return self.compiled._cache_size()  # pyright: ignore


class SparseKernel(Kernel):
    """A time loop with sparse tangents; a singular tangent ends it with a status.

    KLU stops the program at an exactly singular tangent, and all results are lost. Bisection over
    the number of steps then finds the step of that tangent.
    """

    def __call__(self, packed: Float[Array, " n"], *wanted: Any) -> Any:
        result = self._attempt(packed, *wanted)
        if result is not None:
            return result
        fine, wrong = 0, self.most_steps(packed, *wanted)
        while wrong - fine > 1:
            middle = (fine + wrong) // 2
            done = self._attempt(*self.limited(middle, packed, *wanted))
            fine, wrong = (fine, middle) if done is None else (middle, wrong)
        return self.up_to(fine, packed, *wanted)

    @abstractmethod
    def most_steps(self, packed: Float[Array, " n"], *wanted: Any) -> int:
        """Largest number of steps that a run with these arguments takes."""

    @abstractmethod
    def limited(self, steps: int, packed: Float[Array, " n"], *wanted: Any) -> tuple:
        """Arguments of a run that ends after ``steps`` steps."""

    @abstractmethod
    def up_to(self, steps: int, packed: Float[Array, " n"], *wanted: Any) -> Any:
        """The result of ``steps`` steps, with the ending of a singular tangent in the next."""

    def _attempt(self, *arguments: Any) -> Any:
        try:
            return jax.block_until_ready(super().__call__(*arguments))
        except (ValueError, RuntimeError) as error:
            if klu.FAILURE in str(error):
                return None
            raise
