"""Every public method has a docstring, or one of a base class of this project says what it does."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("models", "planners", "controllers", "bridge", "benchmarks")


def name_of(base: ast.expr) -> str:
    base = base.value if isinstance(base, ast.Subscript) else base
    return base.attr if isinstance(base, ast.Attribute) else getattr(base, "id", "")


def methods(owner: ast.ClassDef) -> Iterator[ast.FunctionDef]:
    yield from (each for each in owner.body if isinstance(each, ast.FunctionDef))


def classes() -> dict[str, list[tuple[Path, ast.ClassDef]]]:
    found: dict[str, list[tuple[Path, ast.ClassDef]]] = {}
    for package in PACKAGES:
        for file in sorted((ROOT / package).rglob("*.py")):
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ClassDef):
                    found.setdefault(node.name, []).append((file, node))
    return found


def test_public_methods_are_documented_here_or_in_a_base_class() -> None:
    known = classes()

    def documented(owner: ast.ClassDef, method: str, seen: frozenset[str] = frozenset()) -> bool:
        own = any(each.name == method and ast.get_docstring(each) for each in methods(owner))
        bases = [base for name in map(name_of, owner.bases) if name not in seen for _, base in known.get(name, [])]
        return own or any(documented(base, method, seen | {owner.name}) for base in bases)

    missing = [
        f"{file.relative_to(ROOT)}:{method.lineno}: {owner.name}.{method.name}"
        for entries in known.values()
        for file, owner in entries
        if not owner.name.startswith("_")
        for method in methods(owner)
        if not method.name.startswith("_")
        and not any(isinstance(each, ast.Attribute) and each.attr == "setter" for each in method.decorator_list)
        and not documented(owner, method.name)
    ]
    assert not missing
