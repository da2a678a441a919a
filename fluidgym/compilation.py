"""How the kernels are compiled: all with the same flags, as each set of them wants a precompiled header of its own."""

import warp as wp

_FLAGS = "-march=native" if wp.config.cpu_compiler_flags is None else wp.config.cpu_compiler_flags

# Multiply-adds are fused and sums put in any order, which saves 15 % of a step; what is not a number stays so. On CUDA:
# fast division and square roots.
OPTIONS = {
    "cpu_compiler_flags": f"{_FLAGS} -ffp-contract=fast -mreassociate -fno-signed-zeros",
    "fast_math": True,
}


def shared_module(name: str) -> wp.Module:
    """The module of that name, for kernels that are the same in every structure."""
    module = wp.get_module(f"fluidgym.{name}")
    module.options.update(OPTIONS)
    return module
