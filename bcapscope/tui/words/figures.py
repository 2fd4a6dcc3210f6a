"""Statistics of calls: heads of columns and clauses of `render.statistics_text`, and names of frames."""

PHRASES: dict[str, str] = {
    # statistics
    "all clients": "全クライアント",
    "(other clients)": "(その他のクライアント)",
    "(others)": "(その他)",
    "client": "クライアント",
    "by {word} > {word2} {word3}": "内訳 {word} > {word2} {word3}",
    "by (other clients)": "内訳 (その他のクライアント)",
    "calls": "呼び出し",
    "per s": "毎秒",
    "line time": "占有率",
    "max ms": "最大 ms",
    "late": "遅延",
    "refused": "拒否",
    "retries": "再送",
    "unanswered": "応答なし",
    "refusals": "拒否の内訳",
    "… and {n} more": "… ほか {n} 件",
    "not followed to the end, as too many were open: {text}": "同時に開いたものが多すぎて最後まで追跡しなかったもの: {text}",
    # frames that prove it
    "mode {n}": "モード {n}",
    "frame {n}": "フレーム {n}",
    "frames {numbers}": "フレーム {numbers}",
    "frames {numbers} and {n} more": "フレーム {numbers} ほか {n} 件",
    "and {n} more": "ほか {n} 件",
}
