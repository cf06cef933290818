# SPDX-License-Identifier: Apache-2.0
"""Runs protoc for the message classes when the package is built: they are not kept in the repository. All else is in pyproject.toml."""
import shutil
import subprocess
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py
from setuptools.command.sdist import sdist

HERE = Path(__file__).resolve().parent
# In the repository, and in a source archive.
PROTO = next((p for p in (HERE.parent.parent / "proto" / "airy.proto", HERE / "airy.proto") if p.exists()), None)


class BuildPy(build_py):
    def run(self) -> None:
        super().run()
        if PROTO is None:
            raise SystemExit("airy.proto is neither in ../../proto nor beside setup.py")
        if shutil.which("protoc") is None:
            raise SystemExit("protoc is not installed; it is in Debian's protobuf-compiler")
        out = Path(self.build_lib) / "airy"
        subprocess.run(["protoc", f"--proto_path={PROTO.parent}", f"--python_out={out}", PROTO.name], check=True)


class Sdist(sdist):
    def make_release_tree(self, base_dir: str, files: list[str]) -> None:
        super().make_release_tree(base_dir, files)
        if PROTO is not None:
            shutil.copy(PROTO, Path(base_dir) / "airy.proto")


setup(cmdclass={"build_py": BuildPy, "sdist": Sdist})
