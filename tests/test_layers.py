"""The layout holds: imports run one way, modules stay short, and importing the package stays light."""

import ast
import builtins
import functools
import os
import subprocess
import symtable
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import modalax

SOURCE = Path(__file__).parents[1] / "src" / "modalax"
MODULES = sorted(SOURCE.rglob("*.py"))
LONGEST_MODULE = 400
# A folder may import itself and what stands in an earlier row; what stands in the same row knows nothing of its
# neighbour. The model is what files hold, and the indicators of a model need no file.
LAYERS = (
    {"_lazy", "_numerics"},
    {"data"},
    {"model"},
    {"files"},
    {"check", "identify", "simulate"},
    {"diagnose"},
    {"study"},
    {"show"},
    {"view"},
    {"cli"},
    {"__main__"},
)
# An extended simulation is read from a file by the package that alone knows what its causes are.
UPWARD = {("files/arrays.py", "modalax.diagnose.extend")}
RANK = {name: rank for rank, row in enumerate(LAYERS) for name in row}
parsed = functools.cache(ast.parse)
DRAWING = {"matplotlib", "plotly", "jinja2"}
OPTIONAL = {"pyuff", "xarray", "zarr", "h5netcdf", "pooch", "plotly", "jinja2", "diffrax"}
OPTIONAL |= {"dask", "distributed", "pyarrow", "anywidget", "traitlets"}


def layer_of(path: Path) -> str:
    return path.relative_to(SOURCE).parts[0].removesuffix(".py")


def imported(tree: ast.AST, inside_functions: bool = True) -> list[tuple[str, int]]:
    """Every module named by an import statement, with its line; what only a type checker imports is left out."""
    found = []
    for node in statements(tree, inside_functions):
        if isinstance(node, ast.Import):
            found += [(alias.name, node.lineno) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: relative import; write the whole name"
            module = node.module or ""
            found.append((module, node.lineno))
            if module == "modalax":
                found += [(f"modalax.{alias.name}", node.lineno) for alias in node.names]
    return found


def statements(tree: ast.AST, inside_functions: bool) -> Iterator[ast.AST]:
    """Every statement below a node, in turn; expressions hold none."""
    for node in ast.iter_child_nodes(tree):
        if not isinstance(node, ast.stmt | ast.excepthandler | ast.match_case):
            continue
        if isinstance(node, ast.FunctionDef) and not inside_functions:
            continue
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            continue
        yield node
        yield from statements(node, inside_functions)


def wrong_imports(path: Path, source: str) -> list[str]:
    """Imports of ``source``, the text of the module at ``path``, that run upward or sideways."""
    own = layer_of(path)
    if own == "__init__":
        return []
    wrong = []
    for name, line in imported(parsed(source)):
        parts = name.split(".")
        if parts[0] != "modalax" or len(parts) < 2 or parts[1] not in RANK:
            continue
        if (str(path.relative_to(SOURCE)), name) in UPWARD:
            continue
        if parts[1] != own and RANK[parts[1]] >= RANK[own]:
            wrong.append(f"{path.name}:{line} ({own}) imports {name}")
    return wrong


def test_imports_run_downward():
    assert not {layer_of(path) for path in MODULES} - {*RANK, "__init__"}, "a module stands in no known folder"
    assert [wrong for path in MODULES for wrong in wrong_imports(path, path.read_text())] == []


@pytest.mark.parametrize(
    ("module", "line"),
    [
        ("identify/lscf.py", "from modalax.simulate.harmonic import solve"),
        ("simulate/harmonic.py", "import modalax.identify"),
        ("data/frf.py", "from modalax.model import ModalModel"),
        ("model/modal.py", "from modalax import show"),
        ("diagnose/decide.py", "def f():\n    from modalax.show import plot_frf"),
    ],
)
def test_an_upward_or_sideways_import_is_seen(module, line):
    assert wrong_imports(SOURCE / module, line)


def test_modules_are_short_and_keep_optional_packages_inside_functions():
    long, early, drawing = [], [], []
    for path in MODULES:
        text = path.read_text()
        tree = parsed(text)
        top, every = ({n.split(".")[0] for n, _ in imported(tree, inside_functions=inside)} for inside in (False, True))
        long += [path] if len(text.splitlines()) > LONGEST_MODULE else []
        early += [(path, package) for package in top & OPTIONAL]
        drawing += [(path, package) for package in every & DRAWING if layer_of(path) != "show"]
    assert long == []
    assert early == [], "an optional package is imported when the module is"
    assert drawing == [], "only modalax.show draws"


def in_fresh_python(code: str) -> tuple[str, float]:
    """What ``code`` prints in an interpreter of its own, and the processor seconds that took."""
    start = os.times()
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False)
    end = os.times()
    assert done.returncode == 0, done.stderr
    return done.stdout, end.children_user + end.children_system - start.children_user - start.children_system


def test_importing_the_package_loads_nothing_yet():
    """``import modalax`` draws in neither JAX nor any other package, and sets JAX's pool of threads."""
    heavy = sorted(DRAWING | OPTIONAL | {"jax", "numpy", "scipy", "typer", "rich", "IPython", "tkinter"})
    told, seconds = in_fresh_python(
        f"import os, sys; os.environ.pop('XLA_FLAGS', 0); import modalax; "
        f"print([m for m in {heavy} if m in sys.modules], "
        "int(os.environ['NPROC']) >= 16, all(f.startswith('--xla_cpu') for f in os.environ['XLA_FLAGS'].split()))"
    )
    assert told == "[] True True\n"
    assert seconds < 0.5  # 0.05 measured; JAX alone takes 0.7


def test_compiler_flags_of_the_user_stay():
    told, _ = in_fresh_python(
        "import os; os.environ['XLA_FLAGS'] = '--xla_mine'; import modalax; print(os.environ['XLA_FLAGS'])\n"
        "from modalax._numerics.compiler import lightly; print(lightly())\n"
        "os.environ['XLA_FLAGS'] = '--xla_backend_optimization_level=2'; print(lightly())"
    )
    assert told == "--xla_mine\n{'xla_backend_optimization_level': 1}\n{}\n"


def test_names_load_when_they_are_asked_for():
    """The packages and the names at the top are listed, are there without an import of their own, and lead home.

    None imports pyplot, which keeps every figure alive and picks a window system, and none switches warnings off
    wholesale (NumPy does so with three texts).
    """
    told, _ = in_fresh_python(
        "import sys, warnings\n"
        "before = list(warnings.filters)\n"
        "import modalax\n"
        "assert {n for n in dir(modalax) if not n.startswith('__')} == {*modalax.__all__} - {'__version__'}\n"
        "assert '__version__' in dir(modalax)\n"
        "loaded = {name: getattr(modalax, name) for name in modalax.__all__}\n"
        "import modalax.diagnose, modalax.files, modalax.identify, modalax.simulate, jax\n"
        "assert all(sys.modules[f'modalax.{p}'] is loaded[p] for p in modalax.PACKAGES)\n"
        "assert loaded['FRF'] is modalax.data.FRF and loaded['load'] is modalax.files.load\n"
        "assert callable(modalax.diagnose) and callable(modalax.diagnose.diagnose)\n"
        "told = ('pyuff', 'plotly', 'xarray', 'matplotlib.pyplot')\n"
        "print(modalax.show.plot_frf and jax.config.jax_enable_x64, [m for m in told if m in sys.modules])\n"
        "print([f for f in warnings.filters if f not in before and f[0] == 'ignore' and f[1] is None])\n"
        "for kind in (UserWarning, RuntimeWarning, FutureWarning):\n"
        "    try: warnings.warn('unheard', kind)\n"
        "    except kind: print('heard')"
    )
    assert told == "False []\n[]\n" + 3 * "heard\n"


def test_a_name_that_does_not_exist_is_told():
    with pytest.raises(AttributeError, match="module 'modalax' has no attribute 'frf'"):
        modalax.frf  # noqa: B018


def test_only_the_declared_import_runs_upward():
    """Each exception is still needed."""
    for path, name in UPWARD:
        assert name in {found for found, _ in imported(parsed((SOURCE / path).read_text()))}


def test_no_file_imports_a_private_name_of_another():
    """A name that begins with an underscore belongs to its file; what others need has a public name."""
    for path in MODULES:
        for node in statements(parsed(path.read_text(encoding="utf-8")), inside_functions=True):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("modalax"):
                private = [a.name for a in node.names if a.name.startswith("_") and not a.name.startswith("__")]
                assert private == [] or node.module == "modalax", f"{path}: imports {', '.join(private)}"


def test_every_protocol_can_be_checked_as_the_package_runs():
    """A user who checks annotations as the package runs could otherwise not even import it."""
    unmarked = [
        f"{path}: {node.name}"
        for path in MODULES
        for node in statements(parsed(path.read_text(encoding="utf-8")), inside_functions=True)
        if isinstance(node, ast.ClassDef) and "Protocol" in map(ast.unparse, node.bases)
        and "runtime_checkable" not in map(ast.unparse, node.decorator_list)
    ]  # fmt: skip
    assert unmarked == []


def undefined(source: str, path: str) -> list[str]:
    """Global names that functions use and neither the module nor Python defines."""

    def within(table: symtable.SymbolTable) -> Iterator[symtable.SymbolTable]:
        for part in table.get_children():
            yield part
            yield from within(part)

    whole = symtable.symtable(source, path, "exec")
    inner = [(symbol, table.get_name()) for table in within(whole) for symbol in table.get_symbols()]
    told = {s.get_name() for s in whole.get_symbols() if s.is_assigned() or s.is_imported() or s.is_namespace()}
    told |= {s.get_name() for s, _ in inner if s.is_declared_global() and s.is_assigned()}
    known = told | set(dir(builtins)) | {"__file__", "__name__"}
    used = [(s.get_name(), where) for s, where in inner if s.is_global() and s.is_referenced()]
    return [f"{path}: {name} in {where}" for name, where in used if name not in known]


def test_every_name_that_a_function_uses_is_defined():
    """Shapes in annotations are no names to Python, and so linters are told not to look for undefined ones."""
    every = [
        p for folder in ("src", "tests", "experiments") for p in sorted((SOURCE.parents[1] / folder).rglob("*.py"))
    ]
    found = [line for p in every for line in undefined(p.read_text(encoding="utf-8"), str(p))]
    assert len(every) > len(MODULES) and not found, "\n".join(found)
    assert undefined("def f():\n    return g(len('a'))", "a.py") == ["a.py: g in f"]
