"""How calls went and which frames they have, as `render.call_text` and `render.frame_line` list them."""

PHRASES: dict[str, str] = {
    # how a call ended
    "answered": "応答あり",
    "capture ended": "キャプチャ終了",
    "not followed": "追跡せず",
    "executed twice": "2 回実行",
    "reply late": "応答遅れ",
    "reply lost": "応答喪失",
    "request lost": "要求喪失",
    "cannot tell": "判別不能",
    "{n} S_EXECUTING": "S_EXECUTING {n} 回",
    "{n} duplicate": "重複 {n}",
    "{n} duplicates": "重複 {n}",
    "first try not seen": "最初の送信は観測なし",
    "frames {pair}": "フレーム {pair}",
    "frame {pair}": "フレーム {pair}",
    # its frames
    "frame": "フレーム",
    "serial": "シリアル",
    "at": "時点",
    "discarded": "破棄",
    "{n} more bytes": "ほか {n} バイト",
    # replies that belong to none
    "reply with serial {n} answers no request that was seen": "シリアル {n} の応答 (要求は観測なし)",
    "reply with serial {n} too late for call {n2}": "シリアル {n} の応答 (呼び出し {n2} には遅すぎる)",
    "reply with serial {n} may answer a call that was not followed to the end": "シリアル {n} の応答 (最後まで追跡しなかった呼び出しのものかもしれません)",
}
