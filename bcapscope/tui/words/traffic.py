"""Words of the screen that shows traffic."""

WORDS: dict[str, tuple[str, str]] = {
    "traffic": ("Traffic", "通信"),
    "traffic.about": (
        "What a client and a controller say to each other: from a capture, from an interface of this machine, or"
        " from what the other screens do.\n"
        "Frames are listed one by one, calls with their retries and replies folded under them. Findings tell what"
        " went wrong, the first cause first. Below the list is the frame under the cursor, as a tree and as bytes;"
        " moving over a field lights its bytes, and the other way round.\n"
        "The filter is that of the command line: `command == slvMove and latency > 5ms`, `hresult != S_OK`,"
        " `client == 10.0.0.2`; `bcapscope fields` lists what it knows.",
        "クライアントとコントローラの通信を表示します。キャプチャファイル、このPCのインターフェース、"
        "または他の画面の通信が対象です。\n"
        "フレームは一つずつ、呼び出しは再送と応答をまとめて一覧します。診断は原因から順に示します。"
        "一覧の下にはカーソル位置のフレームをツリーと16進で表示し、項目とバイトは互いに連動します。\n"
        "フィルタはコマンドラインと同じです: `command == slvMove and latency > 5ms`, `hresult != S_OK`,"
        " `client == 10.0.0.2`。項目は `bcapscope fields` で一覧できます。",
    ),
    "traffic.frames": ("Frames", "フレーム"),
    "traffic.calls": ("Calls", "呼び出し"),
    "traffic.findings": ("Findings", "診断"),
    "traffic.slave": ("Slave mode", "スレーブモード"),
    "traffic.statistics": ("Statistics", "統計"),
    "traffic.view.tip": ("Show this view", "この表示に切り替えます"),
    "traffic.filter": ("Filter", "フィルタ"),
    "traffic.filter.tip": ("Show only what an expression is true for", "条件に合うものだけを表示します"),
    "traffic.filter.hint": (
        'such as  command ~ "slv" and hresult != S_OK',
        '例  command ~ "slv" and hresult != S_OK',
    ),
    "traffic.back": ("Back", "戻る"),
    "traffic.back.tip": (
        "From the filter to the list; there, end the filter",
        "フィルタから一覧へ。一覧ではフィルタを解除します",
    ),
    "traffic.partner": ("Request/reply", "要求/応答"),
    "traffic.partner.tip": (
        "Go from a reply to its request, and back",
        "応答から要求へ、要求から応答へ移動します",
    ),
    "traffic.call": ("Call/frame", "呼び出し/フレーム"),
    "traffic.call.tip": (
        "Go from a frame to its call, and back",
        "フレームから呼び出しへ、呼び出しからフレームへ移動します",
    ),
    "traffic.why": ("Why", "原因"),
    "traffic.why.tip": (
        "Go to the finding that names this frame; from a finding to its cause",
        "このフレームに関する診断へ。診断からはその原因へ移動します",
    ),
    "traffic.next": ("Next proof", "次の根拠"),
    "traffic.next.tip": (
        "Go to the next frame that proves the finding",
        "診断の根拠となる次のフレームへ移動します",
    ),
    "traffic.previous": ("Previous proof", "前の根拠"),
    "traffic.previous.tip": (
        "Go to the frame before that proves the finding",
        "診断の根拠となる前のフレームへ移動します",
    ),
    "traffic.mark": ("Mark", "マーク"),
    "traffic.mark.tip": ("Mark the frame, or unmark it", "フレームにマークを付け外しします"),
    "traffic.note": ("Note", "メモ"),
    "traffic.note.tip": ("Write a note on the frame", "フレームにメモを書きます"),
    "traffic.note.title": ("Note on frame {number}", "フレーム {number} のメモ"),
    "traffic.note.hint": ("empty to take it away", "空にすると削除"),
    "traffic.save": ("Save", "保存"),
    "traffic.save.tip": (
        "Save the packets with marks and notes in a new pcapng",
        "マークとメモを付けて新しい pcapng に保存します",
    ),
    "traffic.save.title": ("Save as a new capture", "新しいキャプチャとして保存"),
    "traffic.save.hint": ("name of a file that does not exist yet", "まだ存在しないファイル名"),
    "traffic.saved": ("Saved: {path}", "保存しました: {path}"),
    "traffic.saving": ("Saving {path} …", "{path} に保存中…"),
    "traffic.unsaved": (
        "{path} was not saved whole: {reason}",
        "{path} をすべて保存できませんでした: {reason}",
    ),
    "traffic.nothing_to_save": ("There are no packets to save.", "保存するパケットがありません。"),
    "traffic.open": ("Open a capture", "キャプチャを開く"),
    "traffic.open.tip": ("Show another capture instead of this one", "別のキャプチャに切り替えます"),
    "traffic.open.hint": ("name of a pcap or pcapng file", "pcap または pcapng のファイル名"),
    "traffic.open.recent": ("Open {path}", "{path} を開く"),
    "traffic.open.none": ("{path}: no such file", "{path}: ファイルがありません"),
    "traffic.clock": ("Time", "時刻"),
    "traffic.clock.tip": (
        "Tell the time in another way: since the start, since the line before, in UTC",
        "時刻の表示を切り替えます: 先頭から / 直前の行から / UTC",
    ),
    "traffic.goto": ("Go to", "移動"),
    "traffic.goto.tip": (
        "Go to a frame by number, or to a moment such as 12.5s",
        "番号、または 12.5s のような時刻で移動します",
    ),
    "traffic.goto.title": ("Go to", "移動先"),
    "traffic.goto.hint": ("a number, or seconds since the start: 12.5s", "番号、または先頭からの秒数: 12.5s"),
    "traffic.goto.wrong": (
        "{text}: neither a number nor seconds such as 12.5s",
        "{text}: 番号でも 12.5s のような秒数でもありません",
    ),
    "traffic.follow.client": ("Follow the client", "クライアントを追跡"),
    "traffic.follow.client.tip": (
        "Show only what this client and its server say",
        "このクライアントの通信だけを表示します",
    ),
    "traffic.follow.handle": ("Follow the handle", "ハンドルを追跡"),
    "traffic.follow.handle.tip": (
        "Show only the calls of this object",
        "このオブジェクトへの呼び出しだけを表示します",
    ),
    "traffic.follow.chain": ("Follow the chain", "再送を追跡"),
    "traffic.follow.chain.tip": (
        "Show only the frames of this call",
        "この呼び出しのフレームだけを表示します",
    ),
    "traffic.follow.kind": ("Follow the command", "コマンドを追跡"),
    "traffic.follow.kind.tip": ("Show only this function and command", "この関数・コマンドだけを表示します"),
    "traffic.no_handle": ("This call has no handle.", "この呼び出しにハンドルはありません。"),
    "traffic.no_call": (
        "The call of this frame has not settled yet, or it has none.",
        "このフレームの呼び出しは未確定か、存在しません。",
    ),
    "traffic.no_partner": ("No reply to this was seen.", "応答は観測されていません。"),
    "traffic.no_request": ("The request of this was not seen.", "要求は観測されていません。"),
    "traffic.no_finding": ("No finding names this frame.", "このフレームに関する診断はありません。"),
    "traffic.no_cause": ("This finding is a first cause.", "この診断が最初の原因です。"),
    "traffic.hidden": (
        "Frame {number} is hidden by the filter, which was ended.",
        "フレーム {number} はフィルタで隠れていたため、フィルタを解除しました。",
    ),
    "traffic.unfold": ("Unfold", "ひらく"),
    "traffic.unfold.tip": (
        "Show the frames of the call, or hide them",
        "呼び出しのフレームを表示/非表示にします",
    ),
    "traffic.head.number": ("No.", "番号"),
    "traffic.head.call": ("Call", "番号"),
    "traffic.head.time": ("Time", "時刻"),
    "traffic.head.client": ("Client", "クライアント"),
    "traffic.head.serial": ("Serial", "連番"),
    "traffic.head.reserved": ("Resv", "予約"),
    "traffic.head.what": ("What", "内容"),
    "traffic.reading": ("reading", "読込中"),
    "traffic.live": ("live", "受信中"),
    "traffic.ended": ("ended", "終了"),
    "traffic.lost": ("{count} packets lost", "{count} パケット欠落"),
    "traffic.trouble": ("Reading ended: {reason}", "読み込みが終了しました: {reason}"),
    "traffic.searching": ("searching {percent} %", "検索中 {percent} %"),
    "traffic.about.request": (
        "Frame {number}, {role} of call {call}",
        "フレーム {number}: 呼び出し {call} の{role}",
    ),
    "traffic.about.stray": (
        "Frame {number}, a reply to no open call",
        "フレーム {number}: 対応する呼び出しのない応答",
    ),
    "traffic.about.frame": ("Frame {number}", "フレーム {number}"),
    "traffic.about.answered": (
        "answered in {frame} after {time} ms",
        "{time} ms 後にフレーム {frame} で応答",
    ),
    "traffic.about.unanswered": ("unanswered", "応答なし"),
    "traffic.about.capture_ended": ("unanswered when the capture ended", "キャプチャ終了まで応答なし"),
    "traffic.about.not_followed": ("not followed to the end", "最後まで追跡せず"),
    "traffic.about.packet": ("packet {packet}", "パケット {packet}"),
    "traffic.empty.findings": ("Nothing was found so far.", "まだ診断はありません。"),
    "traffic.empty.slave": ("No slave mode here.", "スレーブモードはありません。"),
    "traffic.empty.statistics": ("No calls so far.", "まだ呼び出しはありません。"),
    "traffic.finding.frames": ("frames: {frames}", "フレーム: {frames}"),
    "traffic.finding.advice": ("what to do: {advice}", "対処: {advice}"),
    "traffic.finding.source": ("source: {source}", "出典: {source}"),
    "findings.choose": ("Its frames", "根拠のフレーム"),
    "findings.choose.tip": (
        "Go to the first frame that proves the finding",
        "診断の根拠となる最初のフレームへ移動します",
    ),
    "traffic.finding.follows": ("follows from {number}", "{number} に起因"),
    "traffic.stop": ("Stop capturing", "受信を停止"),
    "traffic.stop.tip": ("Capture no more; what was seen stays", "受信を停止します。見た内容は残ります"),
    "prompt.accept": ("OK", "OK"),
    "prompt.cancel": ("Cancel", "取消"),
}
