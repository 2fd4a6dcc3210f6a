"""The rules of `diagnose`, from the table `rules.tsv`."""

from __future__ import annotations

import os
from dataclasses import dataclass

from bcapscope.analysis.finding import Severity
from bcapscope.messages import Message
from bcapscope.protocol.tables.table_rows import table_rows


@dataclass(frozen=True, slots=True)
class DiagnosisRule:
    """The constant data of a rule of `diagnose`. A `RuleChecker` applies the rule.

    Attributes:
        id: Short name of the rule, as in JSON.
        possible_causes: Ids of the rules that can report a cause of this rule's findings.
        cause_within_ns: Maximum time in ns from the end of a possible cause to the start of the problem; 0 if
            only problems of the same call can cause the problem.
    """

    id: str
    severity: Severity
    source: str
    possible_causes: tuple[str, ...] = ()
    cause_within_ns: int = 1_000_000_000

    @property
    def title(self) -> Message:
        return Message(f"rule.{self.id}.title")

    @property
    def advice(self) -> Message:
        return Message(f"rule.{self.id}.advice")


def _rule(row: dict[str, str]) -> DiagnosisRule:
    within_ns = int(row["within_s"] or 1) * 1_000_000_000
    return DiagnosisRule(
        row["id"], Severity(row["severity"]), row["source"], tuple(row["possible_causes"].split()), within_ns
    )


RULES = {row["id"]: _rule(row) for row in table_rows("rules", os.path.dirname(__file__))}
