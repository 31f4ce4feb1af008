"""amrpic --version names the version that is installed."""

from __future__ import annotations

from importlib.metadata import version

import pytest

from amrpic.commands.main import parser


def test_version_is_that_of_the_package(capsys):
    with pytest.raises(SystemExit) as ended:
        parser().parse_args(["--version"])
    assert ended.value.code == 0
    assert capsys.readouterr().out == f"amrpic {version('amrpic')}\n"
