"""What is wrong with the bytes of a frame or of a set point, as `protocol` and `capture` say it."""

PHRASES: dict[str, str] = {
    # frames
    "first byte is {word}, a frame begins with 01": "先頭のバイトが {word} です (フレームは 01 で始まります)",
    "there are no bytes, a frame begins with 01": "バイトがありません (フレームは 01 で始まります)",
    "{n} byte, a frame has {n2} at least": "{n} バイトしかありません (フレームは {n2} バイト以上)",
    "{n} bytes, a frame has {n2} at least": "{n} バイトしかありません (フレームは {n2} バイト以上)",
    "length is {n}, there are {n2} bytes": "長さの値は {n} ですが、{n2} バイトあります",
    "last byte is {word}, a frame ends with 04": "最後のバイトが {word} です (フレームは 04 で終わります)",
    "bytes end before EOT": "EOT の前でバイトが終わっています",
    "{n} byte left over behind the last argument": "最後の引数の後に {n} バイト余っています",
    "{n} bytes left over behind the last argument": "最後の引数の後に {n} バイト余っています",
    "a frame breaks off after {n} bytes": "フレームが {n} バイトで途切れています",
    "bytes outside of any frame": "フレームに属さないバイト列です",
    "what follows was not seen": "以降は観測されていません",
    "the stream ends here": "ストリームはここで終わっています",
    "{n} bytes of the stream were not seen": "ストリームの {n} バイトが観測されていません",
    "the capture kept {n} of the datagram's {n2} bytes": "キャプチャはデータグラム {n2} バイトのうち {n} バイトだけを保存しています",
    "the packet holds {n} of the datagram's {n2} bytes": "パケットにはデータグラム {n2} バイトのうち {n} バイトだけがあります",
    # compressed frames
    "unpacks to over {n} bytes, cut there": "展開すると {n} バイトを超えるため、そこで打ち切りました",
    "compressed bytes end early": "圧縮データが途中で終わっています",
    "unpacked size is {n}, there are {n2} bytes": "展開後のサイズの値は {n} ですが、{n2} バイトあります",
    "bytes left over behind the compressed ones": "圧縮データの後にバイトが余っています",
    # arguments
    "argument count is {n}, bytes for {n2}": "引数の数は {n} ですが、{n2} 個分のバイトしかありません",
    "argument length is {n}, type and value take {n2}": "引数の長さの値は {n} ですが、型と値で {n2} バイトです",
    "{word} is no type that b-CAP carries": "{word} は b-CAP で送れる型ではありません",
    "element count of a scalar is {n}, read as one": "スカラの要素数が {n} です (1 として読みました)",
    "the frame has more than {n} elements, the rest is not read": "フレームの要素が {n} 個を超えるため、残りは読み取っていません",
    "only the first {n} problems are listed": "問題は {n} 件まで表示し、残りは省略しています",
    "{n} element of {word} promised, bytes for {n2}": "{word} の要素は {n} 個のはずですが、{n2} 個分のバイトしかありません",
    "{n} elements of {word} promised, bytes for {n2}": "{word} の要素は {n} 個のはずですが、{n2} 個分のバイトしかありません",
    "bytes end before the length of a string": "文字列の長さの前でバイトが終わっています",
    "string length is {n}, UTF-16 takes two bytes a unit": "文字列の長さが {n} です (UTF-16 は 2 バイト単位)",
    "a string of {n} bytes promised, there are {n2}": "文字列は {n} バイトのはずですが、{n2} バイトしかありません",
    "VARIANT arrays nested more than {n} deep": "VARIANT 配列の入れ子が {n} 段を超えています",
    # set points
    "the end": "終わり",
    "the reply to the first set point": "最初の指令値への応答",
    "{word} before": "直前の {word}",
}
