"""What happened, as the findings of `analysis.rules` tell it: clauses, which semicolons and colons join."""

PHRASES: dict[str, str] = {
    # who, how much, how often
    "your client": "クライアント",
    "client {word}": "クライアント {word}",
    "client {word} ({word2})": "クライアント {word} ({word2})",
    "once": "1 回",
    "twice": "2 回",
    "{n} retry": "再送 {n} 回",
    "{n} point": "{n} 点",
    "{n} points": "{n} 点",
    "{n} byte": "{n} バイト",
    "{n} bytes": "{n} バイト",
    "mode {code}": "モード {code}",
    "{clause} and {clause2}": "{clause}、{clause2}",
    "{name} was refused ({code}, the robot moved)": "{name} が拒否されました ({code}、ロボット動作中)",
    # limits
    # pacing
    # preparation
    # slave mode
}
