"""What of a module's text a mutant can change, so that plainer words do not ask for all of its mutants again."""

import ast
from hashlib import sha256
from pathlib import Path


def digest(path: Path) -> str:
    """The digest of a module but for its comments, docstrings and imports."""
    tree = _Bare().visit(ast.parse(path.read_text(encoding="utf-8")))
    return sha256(ast.unparse(tree).encode()).hexdigest()[:16]


class _Bare(ast.NodeTransformer):
    def visit_Expr(self, node: ast.Expr) -> ast.Expr | None:
        return None if isinstance(node.value, ast.Constant) and isinstance(node.value.value, str) else node

    def visit_Import(self, _: ast.Import) -> None:
        return None

    def visit_ImportFrom(self, _: ast.ImportFrom) -> None:
        return None
