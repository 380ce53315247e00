"""Settings of JAX's compiler and threads, which count only until JAX runs its first computation."""

import os


def set_up() -> None:
    """Set the size of the pool of threads and, unless the user has flags of their own, those of the compiler.

    On few cores JAX's CPU runtime can wait for itself when batched factorisations run inside a loop (seen with two
    cores and jaxlib 0.10.1); a larger pool of threads prevents it. Where each program is compiled in one piece and its
    loops are fused by the older of two emitters, compilation takes a third less processor time (a first diagnosis 45
    instead of 68 s), and running takes as long (13.2 and 13.1 s). jaxlib ends a process that names a flag it does not
    have, so that flags are set for the versions they were tried with only.
    """
    os.environ.setdefault("NPROC", str(max(16, os.cpu_count() or 1)))
    if "XLA_FLAGS" in os.environ:
        return
    from jaxlib.version import __version_info__ as version

    flags = []
    if (0, 8) <= version < (0, 13):
        flags.append("--xla_cpu_parallel_codegen_split_count=1")
    if (0, 8) <= version < (0, 11):
        flags.append("--xla_cpu_use_fusion_emitters=false")
    if flags:
        os.environ["XLA_FLAGS"] = " ".join(flags)


def lightly(level: int = 1) -> dict[str, int]:
    """Compiler options of a program that runs tens of times, a few times, or once: level 2, 1 or 0 of 3.

    The lower the level, the sooner a program is compiled and the longer it runs. Where ``XLA_FLAGS`` name a level, that
    counts.
    """
    name = "xla_backend_optimization_level"
    return {} if name in os.environ.get("XLA_FLAGS", "") else {name: level}
