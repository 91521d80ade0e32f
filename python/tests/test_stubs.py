"""The typed stubs say what the modules hold: the same names, arguments and defaults."""

import ast
import importlib
import importlib.util
import inspect
import os
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

import respire_bench
from support import needs

PACKAGE = os.path.dirname(respire_bench.__file__)
DOCUMENT = os.path.join(os.path.dirname(__file__), "..", "..", "docs", "python.md")
MODULES = sorted(name.removesuffix(".pyi") for name in os.listdir(PACKAGE) if name.endswith(".pyi"))


def stub_of(module):
    with open(os.path.join(PACKAGE, f"{module}.pyi")) as file:
        return ast.parse(file.read())


def runtime_of(module):
    return importlib.import_module("respire_bench" if module == "__init__" else f"respire_bench.{module}")


def is_public(name):
    return not name.startswith("_") or (name.startswith("__") and name.endswith("__"))


def signature_of_stub(function):
    """Name, kind and default of each argument; a default is what its literal says."""
    arguments, found = function.args, []
    plain = arguments.posonlyargs + arguments.args
    defaults = [inspect.Parameter.empty] * (len(plain) - len(arguments.defaults)) + arguments.defaults
    for argument, default in zip(plain, defaults):
        found.append((argument.arg, "plain", default))
    if arguments.vararg:
        found.append((arguments.vararg.arg, "rest", inspect.Parameter.empty))
    for argument, default in zip(arguments.kwonlyargs, arguments.kw_defaults):
        found.append((argument.arg, "named", inspect.Parameter.empty if default is None else default))
    return [(name, kind, ast.literal_eval(d) if isinstance(d, ast.AST) else d) for name, kind, d in found]


def signature_of_runtime(function):
    kinds = {"KEYWORD_ONLY": "named", "VAR_POSITIONAL": "rest"}
    parameters = inspect.signature(function).parameters.values()
    return [(p.name, kinds.get(p.kind.name, "plain"), p.default) for p in parameters]


def is_property(function):
    return any(isinstance(d, ast.Name) and d.id == "property" for d in function.decorator_list)


class Stubs(unittest.TestCase):
    def test_the_wheel_has_them(self):
        self.assertTrue(os.path.exists(os.path.join(PACKAGE, "py.typed")))
        self.assertIn("__init__", MODULES)
        with_stub = {m for m in MODULES if m != "__init__"}
        modules = {n.removesuffix(".py") for n in os.listdir(PACKAGE) if n.endswith(".py") and is_public(n.removesuffix(".py"))}
        self.assertEqual(with_stub, modules - {"__init__"})

    def test_the_package_exports_what_its_stub_does(self):
        named = set()
        for node in stub_of("__init__").body:
            if isinstance(node, ast.ImportFrom):
                named |= {alias.asname for alias in node.names if alias.asname == alias.name}
            elif isinstance(node, (ast.ClassDef, ast.FunctionDef)):
                named.add(node.name)
        self.assertEqual(sorted(named), sorted(respire_bench.__all__))
        for name in named:
            self.assertTrue(hasattr(respire_bench, name), name)

    def test_functions_and_classes_are_those_of_the_modules(self):
        for module in MODULES:
            if module == "__init__":
                continue
            runtime, nodes = runtime_of(module), stub_of(module).body
            said = {n.name: n for n in nodes if isinstance(n, (ast.ClassDef, ast.FunctionDef)) and is_public(n.name)}
            held = {
                name
                for name, value in vars(runtime).items()
                if is_public(name) and getattr(value, "__module__", None) == runtime.__name__ and callable(value)
            }
            self.assertEqual(set(said), held, module)
            for name, node in said.items():
                with self.subTest(module=module, name=name):
                    value = getattr(runtime, name)
                    if isinstance(node, ast.FunctionDef):
                        self.assertEqual(signature_of_stub(node), signature_of_runtime(value))
                    else:
                        self.compare_class(node, value)

    def compare_class(self, node, value):
        fields = [n.target.id for n in node.body if isinstance(n, ast.AnnAssign)]
        functions = {n.name: n for n in node.body if isinstance(n, ast.FunctionDef)}
        if issubclass(value, tuple):
            self.assertEqual(fields, list(value._fields))
            return
        for name, function in functions.items():
            held = inspect.getattr_static(value, name)
            if is_property(function):
                self.assertFalse(inspect.isfunction(held), f"{name} is no property")
            else:
                self.assertTrue(inspect.isfunction(held), f"{name} is no method")
                self.assertEqual(signature_of_stub(function), signature_of_runtime(held), name)
        # What a user may use, apart from what every object has.
        own = {name for name in vars(value) if not name.startswith("_")}
        self.assertEqual(own, {name for name in functions if not name.startswith("_")})
        assigned = {
            n.attr
            for n in ast.walk(ast.parse(inspect.getsource(value).lstrip()))
            if isinstance(n, ast.Attribute) and isinstance(n.ctx, ast.Store) and not n.attr.startswith("_")
        }
        self.assertEqual(set(fields), assigned, "attributes")


@needs(importlib.util.find_spec("mypy"), "mypy is not installed here, so that docs/python.md is not type-checked")
class Snippets(unittest.TestCase):
    # What the snippets take as given.
    GIVEN = """
from typing import Any
import numpy
my_method: Any; loss: Any
means = quats = scales = opacities = sh = viewmats = Ks = by_colors = by_alphas = numpy.zeros(3)
width = height = 64
"""

    def check(self, code):
        with tempfile.TemporaryDirectory() as place:
            stubs = os.path.join(place, "respire_bench")
            os.mkdir(stubs)
            for name in ["py.typed", *(f"{module}.pyi" for module in MODULES)]:
                shutil.copy(os.path.join(PACKAGE, name), stubs)
            with open(os.path.join(place, "snippets.py"), "w") as file:
                file.write(code)
            mypy = [sys.executable, "-m", "mypy", "--ignore-missing-imports", "--cache-dir", os.devnull, "snippets.py"]
            done = subprocess.run(mypy, cwd=place, env=os.environ | {"MYPYPATH": place}, capture_output=True, text=True)
            return done.returncode, done.stdout + done.stderr

    def test_they_pass_a_type_checker(self):
        with open(DOCUMENT) as file:
            snippets = re.findall(r"^```python\n(.*?)^```", file.read(), re.M | re.S)
        self.assertGreaterEqual(len(snippets), 3)
        code, said = self.check("\n".join([self.GIVEN, *snippets, "for mesh in film.meshes: mesh.vertices.sum()"]))
        self.assertEqual(code, 0, said)
        code, said = self.check("import respire_bench as rb\nrb.load(3)\nfor x in rb.load('f'): x.imaje\n")
        self.assertEqual((code, said.count("error:")), (1, 2), said)


if __name__ == "__main__":
    unittest.main()
