"""The command line in this process, without the seconds that a process of its own takes to start."""

import io
from contextlib import chdir, redirect_stderr, redirect_stdout
from pathlib import Path
from subprocess import CompletedProcess

from deepgps.cli import main


def deepgps_here(*words: str, cwd: Path) -> CompletedProcess[str]:
    """Run ``deepgps`` with these words in a folder."""
    out, errors, code = io.StringIO(), io.StringIO(), 0
    with chdir(cwd), redirect_stdout(out), redirect_stderr(errors):
        try:
            main(words)
        except SystemExit as ended:
            code = ended.code if isinstance(ended.code, int) else 0
    return CompletedProcess(words, code, out.getvalue(), errors.getvalue())
