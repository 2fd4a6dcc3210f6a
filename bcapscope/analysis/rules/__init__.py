"""The checkers that apply the rules of `diagnose`. The table `rules.tsv` has the data of the rules."""

from __future__ import annotations

from bcapscope.analysis.rules.connection_rules import ConnectionChecker
from bcapscope.analysis.rules.error_list_rules import ErrorListChecker
from bcapscope.analysis.rules.error_rules import ErrorChecker
from bcapscope.analysis.rules.limit_rules import LimitChecker
from bcapscope.analysis.rules.motion_rules import MotionChecker
from bcapscope.analysis.rules.object_rules import ObjectChecker
from bcapscope.analysis.rules.pacing_rules import PacingChecker
from bcapscope.analysis.rules.polling_rules import PollingChecker
from bcapscope.analysis.rules.preparation_rules import PreparationChecker
from bcapscope.analysis.rules.proxy_rules import ProxyChecker
from bcapscope.analysis.rules.refusal_checker import RefusalChecker
from bcapscope.analysis.rules.reply_rules import ReplyChecker
from bcapscope.analysis.rules.request_rules import RequestChecker
from bcapscope.analysis.rules.retry_rules import RetryChecker
from bcapscope.analysis.rules.rule_checker import RuleChecker
from bcapscope.analysis.rules.session_rules import SessionChecker
from bcapscope.analysis.rules.slave_mode_rules import SlaveModeChecker
from bcapscope.analysis.rules.wire_rules import WireChecker

CHECKERS: tuple[type[RuleChecker], ...] = (
    ProxyChecker,  # an injected fault can explain findings of the other checkers, so this checker is first
    WireChecker,
    ConnectionChecker,
    ReplyChecker,
    RetryChecker,
    SessionChecker,
    ObjectChecker,
    PreparationChecker,
    RequestChecker,
    PacingChecker,
    LimitChecker,
    RefusalChecker,
    SlaveModeChecker,
    ErrorChecker,
    ErrorListChecker,
    PollingChecker,
    MotionChecker,
)
"""All checkers. `Diagnosis` passes each call to the checkers in this order."""
