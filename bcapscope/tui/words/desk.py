"""Words of the Tester's desk: what may stand in a field, what was found, why something was not done."""

WORDS: dict[str, tuple[str, str]] = {
    # the Option field
    "desk.option.pair": (
        "{part}: key=value is expected; {help}",
        "{part}: キー=値 の形で入力してください。{help}",
    ),
    "desk.option.unknown": ("{key} is not known; {help}", "{key} は未知のキーです。{help}"),
    "desk.option.whole": (
        "{key}={value}: a whole number from {low} to {high} is expected",
        "{key}={value}: {low} から {high} の整数を入力してください",
    ),
    "desk.option.reserved": (
        "Reserved={value}: one of {allowed} is expected",
        "Reserved={value}: {allowed} のいずれかを入力してください",
    ),
    "desk.option.help": (
        "Timeout=ms, Retry=n, WDT=ms, InvokeTimeout=ms, Provider=name, Machine=name, Name=name, "
        "Reserved=seed|own|chain|tcp0|tcp1; what begins with @ goes to Controller_Connect",
        "Timeout=ms, Retry=回数, WDT=ms, InvokeTimeout=ms, Provider=名前, Machine=名前, Name=名前, "
        "Reserved=seed|own|chain|tcp0|tcp1。@ で始まるものは Controller_Connect に渡します",
    ),
    # parameters
    "desk.expected": ("expected: {what}", "入力: {what}"),
    "desk.expected.several": (
        "expected: {what}; several of it, commas between",
        "入力: {what} (複数はカンマ区切り)",
    ),
    "desk.expected.nothing": ("nothing is expected", "入力不要です"),
    "desk.expected.I2": ("a whole number, -32768 to 32767", "整数 -32768 から 32767"),
    "desk.expected.I4": (
        "a whole number, -2147483648 to 2147483647, or 0x…",
        "整数 -2147483648 から 2147483647、または 0x…",
    ),
    "desk.expected.R4": ("a number", "数値"),
    "desk.expected.R8": ("a number", "数値"),
    "desk.expected.CY": ("a whole number: ten-thousandths", "整数 (1/10000 単位)"),
    "desk.expected.DATE": ("days since 1899-12-30", "1899-12-30 からの日数"),
    "desk.expected.BSTR": ("text", "文字列"),
    "desk.expected.ERROR": ("a result code as a signed whole number", "結果コード (符号付き整数)"),
    "desk.expected.BOOL": ("true or false", "true または false"),
    "desk.expected.UI1": ("a whole number, 0 to 255", "整数 0 から 255"),
    "desk.expected.UI2": ("a whole number, 0 to 65535", "整数 0 から 65535"),
    "desk.expected.UI4": ("a whole number, 0 to 4294967295", "整数 0 から 4294967295"),
    "desk.expected.I8": ("a whole number of 64 bits", "64 ビットの整数"),
    "desk.expected.UI8": ("a whole number of 64 bits, not negative", "64 ビットの整数 (0 以上)"),
    "desk.expected.VARIANT": (
        "values with their types, semicolons between, such as r8[]:10,20;bstr:J",
        "型付きの値をセミコロン区切りで (例 r8[]:10,20;bstr:J)",
    ),
    "desk.command.parameter": ("parameter: {elements}", "パラメータ: {elements}"),
    "desk.command.returns": ("returns {returns}", "戻り値: {returns}"),
    "desk.command.refused": ("refused in slave mode", "スレーブモード中は拒否"),
    # how a call ended
    "desk.unanswered.one": ("no answer to 1 try", "応答なし (1 回試行)"),
    "desk.unanswered.many": ("no answer to {tries} tries", "応答なし ({tries} 回試行)"),
    "desk.given_up": ("given up", "中止しました"),
    # what is there
    "desk.simulator": (
        "bcapscope simulator, no robot moves",
        "bcapscope シミュレータ (ロボットは動きません)",
    ),
    "desk.controller": ("controller", "コントローラ"),
    "desk.version": ("version {version}", "バージョン {version}"),
    "desk.robot.missing": ("no robot is open", "ロボットが開かれていません"),
    "desk.resting": ("not read in slave mode", "スレーブモード中は読みません"),
    # saved requests
    "desk.saved.large": ("{name} is larger than {most} bytes", "{name} は {most} バイトを超えています"),
    "desk.saved.function": (
        "{name}: there is no function {function}",
        "{name}: 関数 {function} はありません",
    ),
    "desk.saved.count": (
        "{name}: {count} arguments, expected: {names}",
        "{name}: 引数が {count} 個ですが、必要なのは {names} です",
    ),
    "desk.saved.none": ("none", "なし"),
    "desk.saved.unknown": (
        "only calls of known functions with all their arguments can be saved",
        "保存できるのは、引数がそろった既知の関数の呼び出しだけです",
    ),
    "desk.saved.half": (
        "half a character (a lone surrogate) cannot be written down: copy it as Python",
        "片方だけのサロゲートは書き表せません。Python としてコピーしてください",
    ),
    "desk.saved.nested": (
        "a VARIANT array in a VARIANT array cannot be written down: copy it as Python",
        "VARIANT 配列の中の VARIANT 配列は書き表せません。Python としてコピーしてください",
    ),
    "desk.saved.name": ("a name is expected", "名前を入力してください"),
}
