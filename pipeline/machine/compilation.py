"""Updates that are compiled for the processor they run on."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import Any

import torch
import torch._inductor
from tensordict import NestedKey, TensorDict, TensorDictBase
from torch import Tensor
from torch._decomp import get_decompositions
from torch._inductor.exc import InductorError
from torch._subclasses import FakeTensorMode
from torch.fx.experimental.proxy_tensor import make_fx
from torch.fx.experimental.symbolic_shapes import ShapeEnv

from pipeline.machine.cuda_graphs import Update
from pipeline.machine.random_state import kept_random_state

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


def _exact_power(base: float, exponent: Tensor) -> Tensor:
    """A power of one number in float64, as torch's own kernel of Adam takes it.

    The share of the past in Adam's second moment is 0.999^n, and it is the difference from one
    that counts, of which float32 leaves four digits at first.
    """
    if exponent.dim() or exponent.dtype != torch.float32:
        return NotImplemented
    return base ** exponent.double()


DECOMPOSITIONS: dict[Any, Callable[..., Any]] = {
    torch.ops.aten.addmm.default: _bias_apart,
    torch.ops.aten.baddbmm.default: _bias_apart,
    torch.ops.aten.pow.Scalar: _exact_power,
    # Taken apart here rather than by Inductor, so that a row's scale can be computed once.
    **get_decompositions(
        [torch.ops.aten.native_layer_norm, torch.ops.aten.native_layer_norm_backward]
    ),
}

EXPAND, RSQRT = torch.ops.aten.expand.default, torch.ops.aten.rsqrt.default


class Compiled:
    """An :data:`~pipeline.machine.cuda_graphs.Update`, compiled at the first batch of each layout.

    On small networks an update is hundreds of calls of torch operations, most of which take longer
    to call than to compute. They are traced once, gradients and Adam included, and TorchInductor
    makes a few loops of what lies between the matrix products. ``torch.compile`` does the same
    from the Python code, but asks at each call whether anything of that code's world has changed,
    forward and backward apart: an update took a quarter longer (docs/performance.md).

    Args:
        update: Decides nothing by a number that changes. What it reads besides the batch and
            ``state`` are tensors, which stay the same objects.
        state: Gives the tensors that the update changes in place and those that may be replaced
            by others of their kind, always in the same order.
    """

    def __init__(self, update: Update, state: Callable[[], Sequence[Tensor]] = list) -> None:
        self._update = update
        self._state = state
        self._compilations: dict[object, _Compilation] = {}

    def __call__(self, batch: TensorDictBase) -> dict[str, Tensor]:
        """Learns from ``batch``; returns what the update returns."""
        # One walk for both, because looking an entry up takes longer than some of the arithmetic.
        # In one order, whatever a batch was put together from: the next run asks for the same.
        entries = sorted(batch.items(include_nested=True, leaves_only=True), key=_name)
        keys, values = zip(*entries, strict=True)
        layout = (batch.batch_size, keys)
        state = self._state()
        if layout not in self._compilations:
            self._compilations[layout] = _Compilation(self._update, *layout, values, state)
        return self._compilations[layout](values, state)


class _Compilation:
    def __init__(
        self,
        update: Update,
        batch_size: torch.Size,
        keys: Sequence[NestedKey],
        values: Sequence[Tensor],
        state: Sequence[Tensor],
    ) -> None:
        self.update = update
        self.batch_size = batch_size
        self.keys = keys
        self.names: tuple[str, ...] = ()
        with warnings.catch_warnings():
            # Of what torch itself still uses.
            warnings.simplefilter("ignore", DeprecationWarning)
            # The tracer makes the update, which must not count.
            with kept_random_state(values[0].device), _kept(state):
                trace = make_fx(self.on_tensors, decomposition_table=DECOMPOSITIONS)
                graph = trace(*values, *state)
            with torch.no_grad():
                self.compiled = _compiled(graph, [*values, *state])

    def __call__(self, values: Sequence[Tensor], state: Sequence[Tensor]) -> dict[str, Tensor]:
        with torch.no_grad():
            results = self.compiled(*values, *state)
        return dict(zip(self.names, results, strict=True))

    def on_tensors(self, *tensors: Tensor) -> list[Tensor]:
        """The update knows its state by itself; the tracer sees that it is what it was given."""
        values = tensors[: len(self.keys)]
        found = self.update(TensorDict(dict(zip(self.keys, values, strict=True)), self.batch_size))
        self.names = tuple(found)
        return list(found.values())


def _name(entry: tuple[NestedKey, Tensor]) -> str:
    return str(entry[0])


@contextmanager
def _kept(tensors: Sequence[Tensor]) -> Iterator[None]:
    """Put tensors back to what they were, without gradients."""
    before = [tensor.detach().clone() for tensor in tensors]
    yield
    for tensor, value in zip(tensors, before, strict=True):
        tensor.detach().copy_(value)
        tensor.grad = None


def _compiled(graph: torch.fx.GraphModule, values: Sequence[Tensor]) -> Callable[..., Any]:
    """``graph`` as loops, called from C++ where it holds nothing that this cannot call."""
    _compute_once(graph.graph)
    for node in graph.graph.nodes:
        # The tracer's accounts of the values do not go together; Inductor makes its own.
        node.meta.pop("val", None)
    # Inductor keeps what it made for the next run where it knows that shapes are of one kind.
    shapes = FakeTensorMode(shape_env=ShapeEnv(), static_shapes=True)
    given: list[Any] = [shapes.from_tensor(value, static_shapes=True) for value in values]
    if values[0].device.type == "cpu":
        with suppress(InductorError):
            return torch._inductor.compile(graph, given, options=OPTIONS | FROM_CPP)
    return torch._inductor.compile(graph, given, options=OPTIONS)


def _compute_once(graph: torch.fx.Graph) -> None:
    """Give numbers that many elements share a place in memory: a step's size, a row's scale.

    Inductor would make them part of those elements' loops, where they are computed again for every
    few of them: they might change in between, for all that the C++ compiler knows.
    """
    for node in list(graph.nodes):
        shared = node.target is RSQRT or (node.op == "call_function" and _dimensions(node) == 0)
        # What is expanded is a gradient of a mean, a number that is known now.
        users = [user for user in node.users if _dimensions(user) and user.target is not EXPAND]
        if shared and users:
            value = node.meta["val"]
            view = (node, list(value.shape), list(value.stride()))
            with graph.inserting_after(node):
                # Of what is viewed like this, Inductor must know where it lies.
                once = graph.call_function(torch.ops.aten.as_strided.default, view)
            for user in users:
                user.replace_input_with(node, once)


def _dimensions(node: torch.fx.Node) -> int | None:
    value = node.meta.get("val")
    return value.dim() if isinstance(value, Tensor) else None


def compiled(update: Update, state: Callable[[], Sequence[Tensor]], enabled: bool) -> Update:
    """``update`` compiled (see :class:`Compiled`), or as it is."""
    return Compiled(update, state) if enabled else update


@functools.cache
def why_not_compiled() -> str | None:
    """What keeps this machine from compiling, or ``None``: tried with a small function."""
    try:
        Compiled(lambda batch: {"sum": batch["x"].sum()})(TensorDict({"x": torch.ones(2)}))
    # Inductor wraps what its code generation, the compiler and the linker raise, each its own way.
    except Exception as error:
        return f"{type(error).__name__}: {error}".strip().splitlines()[0]
    return None
