"""What a compiled program launches on a GPU: read off the text of its optimized HLO."""

import dataclasses
import math
import re
from collections.abc import Iterator
from typing import NamedTuple

#: Instructions that start nothing on the device; `while`, `call` and `conditional` start what is in them.
# fmt: off
_FREE = frozenset({
    "parameter", "constant", "tuple", "get-tuple-element", "bitcast", "after-all", "opt-barrier", "while", "call",
    "conditional", "partition-id", "replica-id", "async-done", "copy-done", "all-reduce-done", "all-gather-done",
    "collective-permute-done",
})
# fmt: on

#: Instructions that read a part of their first operand.
_READS_PART = frozenset({"slice", "dynamic-slice", "gather"})

#: Instructions that write a part of their first operand in place, and which operand that is written.
_WRITES_PART = {"dynamic-update-slice": 1, "scatter": 2}

_COMPUTATION = re.compile(r"^(ENTRY )?%?([\w.-]+) \(.*\{$")
_INSTRUCTION = re.compile(r"^  (?:ROOT )?%?([\w.-]+) = (.*?) ([a-z][\w-]*)\((.*)$")
_ARRAY = re.compile(r"\b([a-z]+[0-9]*)[a-z0-9]*\[([0-9,]*)\]")
_TURNS = re.compile(r'"known_trip_count":\{"n":"(\d+)"\}')


@dataclasses.dataclass
class Launches:
    """What one pass through a computation launches: the program, or a turn of a loop with its condition.

    Loops that turn a known number of times are in the sums, with all of their turns.

    Attributes:
      kernels: kernels, library calls and copies.
      bytes: that these read and write, from and to memory.
      loops: the loops whose turns depend on values, each as one turn. After each turn the host looks whether to go on.
    """

    kernels: int = 0
    bytes: int = 0
    loops: list["Launches"] = dataclasses.field(default_factory=list)

    def add(self, other: "Launches", times: int = 1) -> None:
        """Launch another one's kernels too, so many times."""
        self.kernels += times * other.kernels
        self.bytes += times * other.bytes
        self.loops += other.loops

    @property
    def all_loops(self) -> Iterator["Launches"]:
        """The loops, and those in them."""
        for loop in self.loops:
            yield loop
            yield from loop.all_loops


class _Instruction(NamedTuple):
    """A line of HLO: `%name = shape operation(operands), attributes`."""

    name: str
    size: int
    operation: str
    operands: list[str]
    attributes: str

    def named(self, *attributes: str) -> list[str]:
        """The computations that attributes name."""
        found = [re.search(rf"\b{each}=\{{?(%[\w.-]+(?:, %[\w.-]+)*)", self.attributes) for each in attributes]
        return [name.strip(" %") for match in found if match for name in match[1].split(",")]


def _size(shape: str) -> int:
    """Bytes of an array or a tuple of arrays, as HLO writes their shapes."""
    bits = ((int("".join(filter(str.isdigit, kind)) or 8), dims) for kind, dims in _ARRAY.findall(shape))
    return sum(math.ceil(width * math.prod(map(int, filter(None, dims.split(",")))) / 8) for width, dims in bits)


def _parsed(hlo: str) -> tuple[dict[str, list[_Instruction]], str]:
    """The computations of a module by name, and the name of the one it begins with."""
    computations: dict[str, list[_Instruction]] = {}
    entry = name = ""
    for line in hlo.splitlines():
        if head := _COMPUTATION.match(line):
            name = head[2]
            computations[name] = []
            entry = name if head[1] else entry
        elif found := _INSTRUCTION.match(line):
            operands, _, attributes = found[4].partition(")")
            names = re.findall(r"%([\w.-]+)", operands) or [operands]  # a parameter has its number there
            computations[name].append(_Instruction(found[1], _size(found[2]), found[3], names, attributes))
    return computations, entry


def _bytes(instruction: _Instruction, sizes: dict[str, int], inner: list[_Instruction]) -> int:
    """What an instruction reads and writes: of arrays that it reads or writes a part of, the part.

    Args:
      instruction: what is launched.
      sizes: bytes of the results before it.
      inner: of a fusion, what is fused.
    """
    total, inner_sizes = instruction.size, {each.name: each.size for each in inner}
    parameters = {int(each.operands[0]): each.name for each in inner if each.operation == "parameter"}
    for number, operand in enumerate(instruction.operands):
        whole, name = sizes.get(operand, 0), parameters.get(number)
        uses = [use for use in inner if name in use.operands]
        read = 0 if uses else whole
        for use in uses:
            if use.operation in _READS_PART and use.operands[0] == name:
                read += use.size
            elif use.operation in _WRITES_PART and use.operands[0] == name:
                total += inner_sizes[use.operands[_WRITES_PART[use.operation]]] - use.size
            else:
                read += whole
        total += min(read, whole)
    return total


def count_launches(hlo: str) -> Launches:
    """Count what a program launches.

    Args:
      hlo: text of the optimized module, as `jax.stages.Compiled.as_text` gives it.
    """
    computations, entry = _parsed(hlo)

    def of(name: str) -> Launches:
        total, sizes = Launches(), {}
        for each in computations[name]:
            sizes[each.name] = each.size
            if each.operation == "while":
                turn = Launches()
                for part in each.named("body", "condition"):
                    turn.add(of(part))
                known = _TURNS.search(each.attributes)
                total.add(turn, int(known[1])) if known else total.loops.append(turn)
            elif each.operation in ("call", "conditional"):
                names = each.named("to_apply", "branch_computations", "true_computation", "false_computation")
                total.add(max(map(of, names), key=lambda branch: branch.kernels))
            elif each.operation not in _FREE:
                fused = each.named("calls") if each.operation == "fusion" else []
                total.add(Launches(1, _bytes(each, sizes, computations[fused[0]] if fused else [])))
        return total

    return of(entry)
