"""Gradients that are compiled for the processor they run on."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import torch
import torch._inductor
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torch._inductor.exc import InductorError
from torch._ops import OpOverload
from torch.fx.experimental.proxy_tensor import make_fx

from pipeline.gradients import Gradients, Teaching
from pipeline.random_state import kept_random_state

OPTIONS = {
    # Random numbers are drawn as they would be, so that a compiled run is the ordinary one.
    "fallback_random": True,
}
FROM_CPP = {"cpp_wrapper": True}
"""A twentieth less of a small update than calling the loops from Python (docs/performance.md)."""


def _bias_apart(bias: Tensor, left: Tensor, right: Tensor, **scales: float) -> Tensor:
    """The product of two matrices, and then the bias: torch adds it before it multiplies.

    For that it writes the bias to every row of the result, with a loop of its own, a third as long
    as the product where layers are small. Apart, it joins the loop that comes after the product.
    """
    if scales:
        return NotImplemented
    # Inductor joins the two again where it finds one directly after the other.
    return ((left @ right).unsqueeze(0) + bias).squeeze(0)


DECOMPOSITIONS: dict[OpOverload, Callable[..., Tensor]] = {
    torch.ops.aten.addmm.default: _bias_apart,
    torch.ops.aten.baddbmm.default: _bias_apart,
}


class Compiled:
    """A :class:`Teaching`, compiled at the first batch of each layout.

    On small networks an update is hundreds of calls of torch operations, most of which take longer
    to call than to compute. They are traced once, gradients included, and TorchInductor makes a
    few loops of what lies between the matrix products. ``torch.compile`` does the same from the
    Python code, but asks at each call whether anything of that code's world has changed, forward
    and backward apart: an update took a quarter longer (docs/performance.md).

    Args:
        function: What it reads besides the batch are tensors, which stay the same objects.
    """

    def __init__(self, function: Teaching) -> None:
        self._function = function
        self._compilations: dict[object, _Compilation] = {}

    def __call__(self, batch: TensorDictBase) -> tuple[dict[str, Tensor], Gradients]:
        """What the function returns for ``batch``."""
        # One walk for both, because looking an entry up takes longer than some of the arithmetic.
        keys, values = zip(*batch.items(include_nested=True, leaves_only=True), strict=True)
        layout = (batch.batch_size, keys)
        if layout not in self._compilations:
            self._compilations[layout] = _Compilation(self._function, *layout, values)
        return self._compilations[layout](values)


class _Compilation:
    def __init__(
        self,
        function: Teaching,
        batch_size: torch.Size,
        keys: Sequence[NestedKey],
        values: Sequence[Tensor],
    ) -> None:
        self.function = function
        self.batch_size = batch_size
        self.keys = keys
        self.names: tuple[str, ...] = ()
        with warnings.catch_warnings():
            # Of what torch itself still uses.
            warnings.simplefilter("ignore", DeprecationWarning)
            # The tracer calls the function, whose draws must not count.
            with kept_random_state(values[0].device):
                graph = make_fx(self.on_tensors, decomposition_table=DECOMPOSITIONS)(*values)
            with torch.no_grad():
                self.compiled = _compiled(graph, values)

    def __call__(self, values: Sequence[Tensor]) -> tuple[dict[str, Tensor], Gradients]:
        with torch.no_grad():
            results = self.compiled(*values)
        count = len(self.names)
        return dict(zip(self.names, results[:count], strict=True)), results[count:]

    def on_tensors(self, *values: Tensor) -> list[Tensor]:
        batch = TensorDict(dict(zip(self.keys, values, strict=True)), self.batch_size)
        found, gradients = self.function(batch)
        self.names = tuple(found)
        return [*found.values(), *gradients]


def _compiled(graph: torch.fx.GraphModule, values: Sequence[Tensor]) -> Callable[..., Any]:
    """``graph`` as loops, called from C++ where it holds nothing that this cannot call."""
    for node in graph.graph.nodes:
        # The tracer's accounts of the values do not go together; Inductor makes its own.
        node.meta.pop("val", None)
    if values[0].device.type == "cpu":
        with suppress(InductorError):
            return torch._inductor.compile(graph, [*values], options=OPTIONS | FROM_CPP)
    return torch._inductor.compile(graph, [*values], options=OPTIONS)


def compiled(function: Teaching, enabled: bool) -> Teaching:
    """``function`` compiled, or as it is."""
    return Compiled(function) if enabled else function


@functools.cache
def why_not_compiled() -> str | None:
    """What keeps this machine from compiling, or ``None``: tried with a small function."""
    try:
        Compiled(lambda batch: ({"sum": batch["x"].sum()}, ()))(TensorDict({"x": torch.ones(2)}))
    # Inductor wraps what its code generation, the compiler and the linker raise, each its own way.
    except Exception as error:
        return f"{type(error).__name__}: {error}".strip().splitlines()[0]
    return None
