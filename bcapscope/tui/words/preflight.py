"""Counts and columns of tables."""

PHRASES: dict[str, str] = {
    "from": "から",
    "axis": "軸",
    "unit": "単位",
    "to": "まで",
    "step": "ステップ",
    "speed": "速度",
    "speed/s": "速度/s",
    "acceleration/s²": "加速度/s²",
    "error": "エラー",
    "warning": "警告",
    "note": "注記",
    "1 set point": "指令値 1 個",
    "{n} set points": "指令値 {n} 個",
    "1 time": "1 回",
    "{n} times": "{n} 回",
}
