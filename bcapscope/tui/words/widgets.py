"""Words of the widgets that several screens share."""

WORDS: dict[str, tuple[str, str]] = {
    "lines.start": ("To the start", "先頭へ"),
    "lines.end": ("To the end", "末尾へ"),
    "tree.fold": ("Fold", "たたむ"),
    "tree.fold.tip": ("Fold the branch, or go to the one above", "枝をたたむ、または上の枝へ"),
    "tree.unfold": ("Unfold", "ひらく"),
    "tree.full": ("All elements", "全要素"),
    "tree.full.tip": (
        "Show every element and character, or the first of many",
        "すべての要素・文字を表示 (もう一度で省略)",
    ),
}
