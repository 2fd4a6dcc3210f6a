"""Words of the screen of a proxy, and of the simulator that the screen starts."""

WORDS: dict[str, tuple[str, str]] = {
    "proxy": ("Proxy", "プロキシ"),
    "proxy.about": (
        "The proxy between clients and controllers: who is there, the faults that it makes, the messages that it"
        " holds for you, what it said. What passes is on the screen Traffic.\n"
        "A fault is one line: `loss=5%`, `delay=3ms±1ms if command == slvMove`, `drop reply try 1`;"
        " `bcapscope proxy --help-faults` tells all of them. Space switches one on and off.\n"
        "To hold messages, say which (i): `command == slvChangeMode`. A held one goes on as it is (f), is dropped"
        " (x), or changed: type `set arg[2]=0`, or all bytes in hex. Left alone it goes on unchanged after a"
        " while, or is dropped if its client has given it up. What stops the robot is never held.\n"
        "Above stands how long the proxy itself holds what passes, in microseconds, and what it lost.",
        "クライアントとコントローラの間のプロキシです。接続中のクライアント、注入する障害、保留中の"
        "メッセージ、プロキシからの通知を表示します。通信内容は「通信」画面にあります。\n"
        "障害は1行で書きます: `loss=5%`, `delay=3ms±1ms if command == slvMove`, `drop reply try 1`。"
        "一覧は `bcapscope proxy --help-faults`。スペースキーで入/切します。\n"
        "保留するメッセージは条件 (i) で指定します: `command == slvChangeMode`。保留中のものは、そのまま送信 (f)、"
        "破棄 (x)、または変更できます: `set arg[2]=0` か全バイトの16進。放置すると一定時間後にそのまま送られ、"
        "クライアントが待つのをやめたものは破棄されます。"
        "ロボットを停止させるものは保留されません。\n"
        "上部はプロキシ自身による遅延 (マイクロ秒) と損失です。",
    ),
    "proxy.clients": ("Clients", "クライアント"),
    "proxy.rules": ("Rules", "ルール"),
    "proxy.held": ("Held", "保留"),
    "proxy.told": ("Messages", "通知"),
    "proxy.view.tip": ("Show this list", "この一覧に切り替えます"),
    "proxy.switch": ("On/off", "入/切"),
    "proxy.switch.tip": ("Switch the fault on or off", "障害を入/切します"),
    "proxy.add": ("Add rule", "ルール追加"),
    "proxy.add.tip": ("Type a fault in one line", "障害を1行で入力します"),
    "proxy.remove": ("Remove", "削除"),
    "proxy.remove.tip": ("Take the fault away", "障害を取り除きます"),
    "proxy.forward": ("Send on", "送信"),
    "proxy.forward.tip": ("Send the message on as it came", "メッセージをそのまま送ります"),
    "proxy.drop": ("Drop", "破棄"),
    "proxy.drop.tip": ("Drop the message", "メッセージを破棄します"),
    "proxy.edit": ("Edit", "変更"),
    "proxy.edit.tip": (
        "Change the argument that the cursor of the tree is on, then send it on",
        "ツリーで選んだ引数を変更して送ります",
    ),
    "proxy.bytes": ("Edit bytes", "バイト変更"),
    "proxy.bytes.tip": ("Change all bytes in hex, then send them on", "全バイトを16進で変更して送ります"),
    "proxy.intercept": ("Hold", "保留条件"),
    "proxy.intercept.tip": ("Say which messages are to be held", "保留するメッセージを指定します"),
    "proxy.back": ("Back", "戻る"),
    "proxy.back.tip": ("From the line to the list", "入力から一覧へ戻ります"),
    "proxy.intercept.title": ("Hold messages that this is true for", "次の条件のメッセージを保留"),
    "proxy.intercept.hint": (
        "such as command == slvMove; empty for none",
        "例 command == slvMove、空で保留なし",
    ),
    "proxy.intercept.none": ("nothing is held: i says what shall be", "保留条件なし: i で指定します"),
    "proxy.intercept.is": ("holds", "保留条件"),
    "proxy.add.hint": (
        "such as  loss=5%   delay=3ms±1ms if command == slvMove   drop reply try 1",
        "例  loss=5%   delay=3ms±1ms if command == slvMove   drop reply try 1",
    ),
    "proxy.edit.hint": (
        "set arg[2]=0, or all bytes in hex; ⏎ sends",
        "set arg[2]=0 または全バイトの16進、⏎ で送信",
    ),
    "proxy.edit.empty": (
        "expected set arg[2]=0, or all bytes in hex",
        "set arg[2]=0 または全バイトの16進を入力してください",
    ),
    "proxy.edit.hex": ("expected two hex digits a byte", "1バイトにつき16進2桁で入力してください"),
    "proxy.edit.same": (
        "that changes nothing: no such argument, a value that does not fit its type, or the one that it has",
        "変更がありません: 引数がない、型に合わない、または同じ値です",
    ),
    "proxy.sent": ("Message {number} was sent on", "メッセージ {number} を送信しました"),
    "proxy.edited": (
        "Message {number} was changed and sent on",
        "メッセージ {number} を変更して送信しました",
    ),
    "proxy.dropped": ("Message {number} was dropped", "メッセージ {number} を破棄しました"),
    "proxy.refusal": ("The proxy refuses: {reason}", "プロキシが拒否しました: {reason}"),
    "proxy.gone": ("The proxy does not answer: {reason}", "プロキシが応答しません: {reason}"),
    "proxy.ended": ("The proxy has ended: {reason}", "プロキシが終了しました: {reason}"),
    "proxy.no_words": ("it was killed", "強制終了されました"),
    "proxy.here": ("● {way}", "● {way}"),
    "proxy.not_here": ("○ {way}", "○ {way}"),
    "proxy.unrecorded": (
        "This proxy records nothing, so its traffic is not shown; start it with --record",
        "このプロキシは記録していないため通信を表示できません。--record を付けて起動してください",
    ),
    "proxy.waiting": ("held {count}", "保留 {count}"),
    "proxy.held.up": ("held up  ", "遅延 上り"),
    "proxy.held.down": ("held down", "遅延 下り"),
    "proxy.most": ("max", "最大"),
    "proxy.datagrams": ("datagrams in/out: up {up} down {down}", "データグラム 入/出: 上り {up} 下り {down}"),
    "proxy.tcp": ("TCP bytes: up {up} down {down}", "TCP バイト: 上り {up} 下り {down}"),
    "proxy.faults": ("faults {count}", "障害 {count}"),
    "proxy.refused": ("refused {count}", "拒否 {count}"),
    "proxy.lost": ("lost {count}", "損失 {count}"),
    "proxy.denied": ("not allowed {count}", "不許可 {count}"),
    "proxy.script.off": ("script off, motion refused", "スクリプト停止・動作拒否"),
    "proxy.unwatched": ("unseen {count}", "未記録 {count}"),
    "proxy.slow": (
        "the proxy itself was too slow {count} times: over {limit} ms, {worst} ms at worst",
        "プロキシ自身の遅延が {limit} ms を {count} 回超過 (最大 {worst} ms)",
    ),
    "proxy.empty.clients": ("no client has come yet", "クライアントはまだありません"),
    "proxy.empty.rules": ("there are no faults: a adds one", "障害なし: a で追加します"),
    "proxy.empty.held": ("no message waits", "保留中のメッセージはありません"),
    "proxy.empty.told": (
        "nothing was said here; a proxy that ran already says it in its own terminal",
        "通知はありません。既存のプロキシの通知はそちらの端末に表示されます",
    ),
    "proxy.head.client": ("client", "クライアント"),
    "proxy.head.transport": ("", ""),
    "proxy.head.since": ("for", "経過"),
    "proxy.head.up": ("up", "上り"),
    "proxy.head.down": ("down", "下り"),
    "proxy.head.heard": ("heard", "最終"),
    "proxy.head.upstream": ("controller", "コントローラ"),
    "proxy.head.rule": ("rule", "ルール"),
    "proxy.head.injected": ("injected", "回数"),
    "proxy.head.what": ("what it does", "内容"),
    "proxy.head.left": ("left", "残り"),
    "proxy.head.message": ("message", "メッセージ"),
    "proxy.on": ("on", "入"),
    "proxy.off": ("off", "切"),
    "proxy.upstream.refused": ("refused", "拒否"),
    "proxy.upstream.connecting": ("connecting", "接続中"),
    "proxy.upstream.unanswered": ("unanswered", "応答なし"),
    "proxy.upstream.open": ("not asked", "未送信"),
    "proxy.upstream.silent": ("silent {seconds} s", "無応答 {seconds} 秒"),
    "proxy.upstream.answers": ("answers", "応答あり"),
    "simulator.ended": ("The simulator has ended: {reason}", "シミュレータが終了しました: {reason}"),
    "simulator.listens": (
        "A simulator answers on {address}, UDP and TCP",
        "シミュレータが {address} (UDP/TCP) で応答します",
    ),
}
