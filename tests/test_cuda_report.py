"""What is read from programs and assembly for a GPU: registers, spills, and what a candidate costs."""

import pytest
import warp as wp

from fluidgym import cuda_report
from fluidgym.speed import compiled_kernels

LOOP = """
$L__BB0_3:
	sqrt.approx.ftz.f32 	%f1, %f2;
	@%p1 bra 	$L__BB0_9;
	ld.global.v4.f32 	{%f1, %f2, %f3, %f4}, [%rd1];
	ld.global.f32 	%f5, [%rd1+16];
	sub.ftz.f32 	%f6, %f1, %f2;
	fma.rn.ftz.f32 	%f7, %f6, %f6, %f3;
	mul.lo.s32 	%r1, %r2, %r3;
	sqrt.approx.ftz.f32 	%f8, %f7;
	ld.global.v4.f32 	{%f1, %f2, %f3, %f4}, [%rd2];
	ld.global.f32 	%f5, [%rd2+16];
	sub.ftz.f32 	%f6, %f1, %f2;
	fma.rn.ftz.f32 	%f7, %f6, %f6, %f3;
	sqrt.approx.ftz.f32 	%f8, %f7;
	bra.uni 	$L__BB0_3;
"""


def test_the_first_block_that_reads_records_is_counted_by_turns():
    assert cuda_report.inner_loop(LOOP) == (4, 20)
    assert cuda_report.inner_loop("$L__BB0_1:\n\tmul.ftz.f32 %f1, %f2, %f3;\n") == (0, 0)


@pytest.fixture(scope="module")
def kernels():
    """Those of a step in two dimensions, by name."""
    return {kernel.name: kernel for kernel in compiled_kernels(2)}


def test_no_kernel_of_a_step_spills(kernels):
    assert set(kernels) == {"drift", "gather", "advance_density", "kick"}
    for kernel in kernels.values():
        assert 16 <= kernel.registers <= 128
        assert kernel.stack_bytes == 0
        assert kernel.name in kernel.line()


def test_only_the_sweeps_have_a_loop_over_pairs(kernels):
    # A record is place, velocity, field and acceleration in one sweep, and without the last in the other.
    assert kernels["advance_density"].bytes_per_candidate == 32
    assert kernels["kick"].bytes_per_candidate == 20
    for name, kernel in kernels.items():
        assert (kernel.flops_per_candidate > 20) == (name in ("advance_density", "kick"))


Table = wp.types.vector(40, wp.float32)


@wp.kernel(module="unique", enable_backward=False)
def with_a_table(index: wp.array[int], out: wp.array[float]):
    """Has an array of its own that cannot be kept in registers."""
    i = wp.tid()
    table = Table()
    for k in range(40):
        table[index[k] % 40] = float(k)
    out[i] = table[index[i] % 40]


def test_a_stack_is_seen(tmp_path):
    (program,) = wp.compile_aot_module(with_a_table.module, arch=90, module_dir=tmp_path, use_ptx=False)
    registers, stack = cuda_report.resources(program.read_bytes())
    assert registers > 0
    assert stack >= 160
