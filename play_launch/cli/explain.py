"""What ``play-launch explain`` does: says in plain sentences what went wrong in a session."""

from __future__ import annotations

import msgspec

from play_launch.cli import options
from play_launch.cli.info import report_damage
from play_launch.cli.output import fail, printable, say
from play_launch.cli.story_words import paragraphs
from play_launch.postmortem.bag_reader import NotARecordingError
from play_launch.postmortem.findings import is_wrong
from play_launch.postmortem.locate import located
from play_launch.postmortem.story import read_story
from play_launch.supervisor.outcome import ExitCode


def explain(file: options.Recording, as_json: options.Json = False) -> int:
    """Explain what went wrong in a session: first failure, cause, source line, affected nodes.

    Exits with 0 if nothing went wrong, with 1 if something did, with 2 if the file is not a
    recording, and with 5 if the recording could not be read completely. Source lines need addr2line
    (binutils) and the libraries of the session on this machine.
    """
    try:
        story = read_story(file)
    except NotARecordingError as error:
        fail(str(error))
    findings = located(story.findings)
    wrong = is_wrong(findings)
    session, reader = story.session, story.session.reader
    if as_json:
        values = {
            "path": str(reader.path),
            "session": session.about,
            "started_ns": session.started_ns,
            "begin_ns": reader.begin,
            "end_ns": reader.end,
            "complete": reader.is_complete and not reader.damages,
            "damages": [str(damage) for damage in reader.damages],
            "wrong": wrong,
            "findings": [
                {"signature_id": each.signature.id if each.signature else None}
                | msgspec.to_builtins(each)
                for each in findings
            ],
        }
        say(msgspec.json.encode(values).decode())
    else:
        for line in paragraphs(findings, session):
            say(printable(line))
    if report_damage(reader):
        return ExitCode.DAMAGED
    return ExitCode.NODE_FAILED if wrong else ExitCode.OK
