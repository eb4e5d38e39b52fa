"""House words that stand for a term of the field: in no name of a function, class or field, and in
no message.
"""

import ast
import re
from pathlib import Path

import uqsphere

NAMES = re.compile(
    r"(?<![a-z])(found|told|said|says?|asked|chance|alone|beside|dear|lacking|halves|heed|grant|due|"
    r"miss|missed|hold)(?![a-z])",
    re.IGNORECASE,
)
MESSAGES = re.compile(
    r"\b(told|said|asked|chance|alone|dear|lacking|heeds?|granted|likeliest|is due|ways? to "
    r"break)\b"
)
#: fields of the compiled record of lanes, and Limit.missed
LEFT = {("mechanics", "alone"), ("mechanics", "asked"), ("study", "missed")}


def test_names_and_messages_have_the_words_of_the_field() -> None:
    root = Path(uqsphere.__file__).parent
    used = {
        ("page", word)
        for word in MESSAGES.findall((root / "report" / "page.html").read_text("utf-8"))
    }
    for path in root.rglob("*.py"):
        room, tree = (
            path.relative_to(root).parts[0].removesuffix(".py"),
            ast.parse(path.read_text("utf-8")),
        )
        nodes = [*ast.walk(tree)]
        classes = [node for node in nodes if isinstance(node, ast.ClassDef)]
        names = [node.name for node in nodes if isinstance(node, ast.FunctionDef | ast.ClassDef)]
        names += [
            ast.unparse(s.target)
            for node in classes
            for s in node.body
            if isinstance(s, ast.AnnAssign)
        ]
        used |= {(room, word.lower()) for name in names for word in NAMES.findall(name)}
        prose = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        texts = [str(n.value) for n in nodes if isinstance(n, ast.Constant) and id(n) not in prose]
        used |= {(room, word) for text in texts if " " in text for word in MESSAGES.findall(text)}
    assert used <= LEFT, sorted(used - LEFT)
