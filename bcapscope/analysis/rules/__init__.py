"""Rules: what can be wrong, and what looks for it."""

from __future__ import annotations

from bcapscope.analysis.rules.connection import Connection
from bcapscope.analysis.rules.errors import Errors
from bcapscope.analysis.rules.limits import Limits
from bcapscope.analysis.rules.objects import Objects
from bcapscope.analysis.rules.pacing import Pacing
from bcapscope.analysis.rules.polling import Polling
from bcapscope.analysis.rules.preparation import Preparation
from bcapscope.analysis.rules.refusals import Refusals
from bcapscope.analysis.rules.replies import Replies
from bcapscope.analysis.rules.requests import Requests
from bcapscope.analysis.rules.retries import Retries
from bcapscope.analysis.rules.rule import Rule, Watcher
from bcapscope.analysis.rules.session import Session
from bcapscope.analysis.rules.slavemode import SlaveMode
from bcapscope.analysis.rules.wire import Wire

WATCHERS: tuple[type[Watcher], ...] = (
    *(Wire, Connection, Replies, Retries, Session, Objects, Preparation, Requests),
    *(Pacing, Limits, Refusals, SlaveMode, Errors, Polling),
)
"""All watchers, in the order in which they see a call."""

RULES: tuple[Rule, ...] = tuple(dict.fromkeys(rule for watcher in WATCHERS for rule in watcher.rules))
"""All rules, each once."""
