"""What the kernels of a step are on a GPU, as the compiler leaves them: registers, spills, and what a pair costs.

It takes no GPU: the compiler comes with Warp. Registers and stack are read from the machine code's own tables, and what
a candidate pair costs is counted in the innermost loop of the assembly that the compiler was given. A candidate is a
particle of the rows that are gone through; a neighbour is one of them that the smoothing kernel reaches.
"""

from __future__ import annotations

import re
import struct
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import warp as wp

from fluidgym.solver import Solver
from fluidgym.sph.integrate import make_step

ARCHITECTURE = 90

# Of the table .nv.info of a kernel: entries of a number and a symbol's value.
_REGISTERS, _FRAME = 0x2F, 0x11
_VALUE_FORMAT = 4

# Floating-point operations of an instruction.
_OPERATIONS = {"fma": 2, "add": 1, "sub": 1, "mul": 1, "div": 1, "sqrt": 1, "rsqrt": 1, "rcp": 1, "max": 1, "min": 1}


@dataclass(frozen=True)
class CudaKernel:
    """A kernel as it is compiled.

    Attributes:
        dim: Number of dimensions.
        name: Of the kernel.
        registers: Of a thread.
        stack_bytes: Of a thread; without local arrays it is what was spilled [bytes].
        flops_per_candidate: Floating-point operations of the loop over particles; 0 where there is none.
        bytes_per_candidate: What that loop reads of a candidate [bytes].
    """

    dim: int
    name: str
    registers: int
    stack_bytes: int
    flops_per_candidate: int
    bytes_per_candidate: int

    HEAD = "dim  kernel           registers  stack bytes  flops a candidate  bytes a candidate"

    def line(self) -> str:
        """One row under HEAD."""
        return (
            f"{self.dim}D   {self.name:<15}  {self.registers:9}  {self.stack_bytes:11}  {self.flops_per_candidate:17}"
            f"  {self.bytes_per_candidate:17}"
        )


def compiled(solver: Solver) -> Iterator[CudaKernel]:
    """The kernels of a step of a solver, as a GPU would have them."""
    structure = replace(solver._structure, half=False)
    kernels: dict[str, Any] = {name: kernel for name, kernel in vars(make_step(structure)).items() if kernel}
    for name, kernel in kernels.items():
        with tempfile.TemporaryDirectory(prefix="fluidgym-cuda-") as folder:
            options: dict[str, Any] = {"arch": ARCHITECTURE, "module_dir": folder}
            (program,) = wp.compile_aot_module(kernel.module, use_ptx=False, **options)
            registers, stack = resources(Path(program).read_bytes())
            (assembly,) = wp.compile_aot_module(kernel.module, use_ptx=True, **options)
            flops, taken = inner_loop(Path(assembly).read_text())
        yield CudaKernel(structure.dim, name, registers, stack, flops, taken)


def resources(program: bytes) -> tuple[int, int]:
    """Most registers and most stack [bytes] of any kernel in a program for a GPU (an ELF file of 64 bits)."""
    (table,) = struct.unpack_from("<Q", program, 0x28)
    size, count, names = struct.unpack_from("<HHH", program, 0x3A)
    sections = [struct.unpack_from("<IIQQQQ", program, table + n * size) for n in range(count)]
    strings = sections[names][4]
    registers, stack = 0, 0
    for name, _, _, _, at, length in sections:
        begin = strings + name
        if program[begin : program.index(b"\0", begin)] != b".nv.info":
            continue
        place = at
        while place < at + length:
            layout, attribute, value = struct.unpack_from("<BBH", program, place)
            place += 4
            if layout == _VALUE_FORMAT:
                if attribute == _REGISTERS:
                    registers = max(registers, struct.unpack_from("<II", program, place)[1])
                if attribute == _FRAME:
                    stack = max(stack, struct.unpack_from("<II", program, place)[1])
                place += value
    return registers, stack


def inner_loop(assembly: str) -> tuple[int, int]:
    """Floating-point operations and bytes read of a turn of the first loop that reads records; 0 without one.

    Args:
        assembly: PTX.
    """
    # A block ends at a label, and where it may be left. The first that reads records is one turn, or some unrolled.
    for block in re.split(r"^\$L__BB\w+:|\bbra\b.*$", assembly, flags=re.MULTILINE):
        loads = re.findall(r"ld\.global(?:\.nc)?(?:\.v(\d))?\.f32", block)
        if "4" not in loads or "sqrt" not in block:
            continue
        turns = max(1, len(re.findall(r"\bsqrt\.", block)))
        found = re.findall(r"^\s*(?:@%p\d+ )?(\w+)\.[\w.]*f32", block, flags=re.MULTILINE)
        taken = sum(4 * int(count or 1) for count in loads)
        return sum(_OPERATIONS.get(name, 0) for name in found) // turns, taken // turns
    return 0, 0
