"""What the fields of a frame stand for, as `protocol` and `render` say it in a tree."""

PHRASES: dict[str, str] = {
    # sizes
    "{n} element": "要素 {n} 個",
    "{n} elements": "要素 {n} 個",
    "{n} more": "ほか {n} 個",
    "{n} more characters": "ほか {n} 文字",
    "as currency {n}": "通貨値 {n}",
    "unpacked, the first 9 bytes and EOT as above:": "展開後 (先頭の 9 バイトと EOT は上と同じ):",
    # arguments and results
    "handle of a {word}": "{word} のハンドル",
    "tool tip": "ツール先端",
    "bit {n}": "ビット {n}",
    # set points
    "{word} pose, guessed": "{word} 型の位置 (推定)",
    "{word} and {word2} pose": "{word} 型と {word2} 型の位置",
    "{word} and {word2} pose, guessed": "{word} 型と {word2} 型の位置 (推定)",
    "parts guessed": "区分は推定",
    "bit for each axis that the ROS driver uses": "ROS ドライバが使う軸のビット",
    # keys in options
    "use the object that exists when the name is taken": "同名のオブジェクトがあればそれを使う",
    "1 makes the file": "1 でファイルを作成",
    "the handle is the object's number (RC7)": "ハンドルはオブジェクトの番号 (RC7)",
    "ms between two S_EXECUTING": "S_EXECUTING の間隔 (ms)",
    "ms that a call may run": "呼び出しの最長実行時間 (ms)",
    "polling of messages in ms (COBOTTA PRO)": "メッセージの取得間隔 (ms、COBOTTA PRO)",
    "address of a camera": "カメラのアドレス",
    "speed in percent": "速度 (%)",
    "acceleration in percent": "加速度 (%)",
    "deceleration in percent": "減速度 (%)",
    "duration of the motion": "動作時間",
    "the call returns before the motion ends": "動作の完了を待たずに戻る",
    # providers
    "RC7, which ignores the name": "RC7 (名前は無視される)",
    "RC8, RC8A, COBOTTA": "RC8、RC8A、COBOTTA",
    "RC9, COBOTTA PRO": "RC9、COBOTTA PRO",
    "provider for a PC; refused over b-CAP with E_INVALIDARG": "PC 用のプロバイダ。b-CAP では E_INVALIDARG で拒否される",
    "EVP2 vision": "EVP2 ビジョン",
    "electric hand ESC11": "電動ハンド ESC11",
    "Canon camera": "Canon のカメラ",
    # answers
    "after {n} retry": "再送 {n} 回の後",
    "after {n} retries": "再送 {n} 回の後",
}
