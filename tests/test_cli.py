import subprocess
import sys
from pathlib import Path

import pytest

from mjris.cli import main

COMMAND = str(Path(sys.executable).with_name("mjris"))


def test_help_ends_quietly_when_its_reader_has_seen_enough():
    with subprocess.Popen(
        [COMMAND, "train", "--help"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, bufsize=0
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait() == 1


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ["train", "--out", "{}/new", "--preset", "none"],
            "preset: 'none' is not known: it is one of office, demo, wifi",
        ),
        (["train", "--out", "{}/new", "--radio.num-users", "4"], "unrecognized"),
        (["train", "--out", "{}/new", "--world.layout", "{}/none.toml"], "none.toml"),
        (["evaluate", "--run", "{}/none"], "is not allowed: there is no such folder"),
        (["evaluate", "--run"], "run: no folder is given"),
        (["render", "--slots", "0"], "slots: 0 is not allowed"),
    ],
)
def test_bad_input_ends_in_status_2_and_says_why(tmp_path, capsys, arguments, sentence):
    with pytest.raises(SystemExit) as ended:
        main([argument.format(tmp_path) for argument in arguments])
    assert ended.value.code == 2
    printed = capsys.readouterr()
    assert sentence.lower() in (printed.err + printed.out).lower()
    assert not list(tmp_path.iterdir())
