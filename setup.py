"""What pyproject.toml cannot say: links of the README that work anywhere, a build's commit, kernels in C."""

import re
import subprocess
from pathlib import Path

from setuptools import Extension, setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent
HOME = "https://github.com/chachart/chachart"


def absolute(link: re.Match[str]) -> str:
    """A Markdown link with its path in the checkout made an address."""
    kind = "raw" if link["image"] else "blob"
    return f"{link['image']}[{link['text']}]({HOME}/{kind}/main/{link['path']})"


def long_description() -> str:
    """README.md with absolute links."""
    readme = (ROOT / "README.md").read_text("utf-8")
    return re.sub(r"(?P<image>!?)\[(?P<text>[^\]]*)\]\((?P<path>(?!https?:|#)[^)]+)\)", absolute, readme)


class BuildWithCommit(build_py):
    """Writes the commit into the build; an editable install asks git when it runs."""

    def run(self) -> None:
        """Build, then add the commit."""
        super().run()
        if self.editable_mode or not (ROOT / ".git").exists():
            return
        command = ["git", "-C", str(ROOT), "describe", "--always", "--dirty", "--exclude", "*"]
        try:
            commit = subprocess.run(command, capture_output=True, text=True, check=True).stdout
        except (OSError, subprocess.SubprocessError):
            return
        Path(self.build_lib, "chachart", "node", "data", "commit.txt").write_text(commit, "ascii")


setup(
    long_description=long_description(),
    long_description_content_type="text/markdown",
    cmdclass={"build_py": BuildWithCommit},
    ext_modules=[
        Extension(
            "chachart.node.estimation.native.kernels",
            ["node/estimation/native/kernels.c"],
            depends=["node/estimation/native/kernels.h"],
            extra_compile_args=["-O3", "-fno-math-errno", "-Wno-psabi"],
            libraries=["m"],
            optional=True,  # numpy does the same
        )
    ],
)
