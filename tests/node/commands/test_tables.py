from __future__ import annotations

from chachart.node.commands.shared.tables import as_csv, as_latex

ROWS = [
    {"method": "a_b & c", "TW": 0.99987, "frames": 20480, "error_m": None},
    {"method": "joint", "TW": 1.0, "frames": 5, "error_m": 123.456},
]


def test_csv() -> None:
    assert as_csv(ROWS) == "method,TW,frames,error_m\na_b & c,0.99987,20480,\njoint,1.0,5,123.456\n"


def test_latex() -> None:
    assert as_latex(ROWS).splitlines() == [
        r"% \usepackage{booktabs}",
        r"\begin{tabular}{lrrr}",
        r"\toprule",
        r"method & TW & frames & error\_m \\",
        r"\midrule",
        r"a\_b \& c & 0.9999 & 20480 & -- \\",
        r"joint & 1.0000 & 5 & 123.5 \\",
        r"\bottomrule",
        r"\end{tabular}",
    ]


def test_no_cell_is_a_formula() -> None:
    rows = [{"name": text, "n": -5} for text in ("=1+1", "+a", "-a", "@a", "\ta", "a=b")]
    assert as_csv(rows) == "name,n\n'=1+1,-5\n'+a,-5\n'-a,-5\n'@a,-5\n'\ta,-5\na=b,-5\n"
