"""Result codes with a known name or meaning, in bcapscope's own words.

Symbols: orin_bcap CSharp ORiNDefine.cs, C/include/dn_common.h and b-Cap.h of the ANSI-C client (prefix
`BCAP_`). Controller codes: the public list of controller errors in nkawa/Denso_CobottaPro900_MQTT_Control,
issues of DENSORobot/denso_robot_ros and orin_bcap, and start-jsk/denso denso_controller/src/main.cpp.
Four-digit codes of RC7: DENSO Wave 2009, How to use the Slave mode. Data only; `hresult` reads it.
"""

from __future__ import annotations

from typing import NamedTuple


class HresultEntry(NamedTuple):
    """Meaning of a result code.

    Attributes:
        code: The result code, unsigned.
        name: The vendor's symbol; None if unknown.
        text: What the code means, one clause.
        advice: What to do about the code; None without advice.
        rc7: The four-digit code of RC7 with the same meaning; None if unknown.
    """

    code: int
    name: str | None
    text: str
    advice: str | None = None
    rc7: str | None = None


class AxisFamily(NamedTuple):
    """Eight result codes that differ only in the last digit, the axis 1..8; `base` has axis 0."""

    base: int
    text: str
    advice: str | None = None


class CodeRange(NamedTuple):
    """A range of result codes with a common meaning; `{number}` in `text` stands for the low 16 bits."""

    first: int
    last: int
    text: str
    advice: str | None = None


_CLEAR = "read the errors first, then ClearError"
_RESEND = "send the same point again after one cycle; slow the loop down to the 8 ms of the controller"
_RESTART = "look for the first error before it, then ClearError, Motor on and slvChangeMode again"
_SLOWER = "smaller steps per 8 ms; check the set points around it for a jump, and the interval for a gap"
_LIMIT = "keep the set points inside the axis's range; check units and the order of axes"
_AUTO = "switch the mode on the pendant"

NAMED_CODES: tuple[HresultEntry, ...] = (
    HresultEntry(0x00000000, "S_OK", "done"),
    HresultEntry(0x00000001, "S_FALSE", "done, with a negative answer"),
    HresultEntry(0x00000900, "S_EXECUTING", "still working: a keep-alive, not a result", "keep waiting"),
    HresultEntry(
        0x0F200501,
        "S_BUF_FULL",
        "set point accepted, and the slave-mode buffer is now full",
        "wait one cycle before the next slvMove; one more now is refused with 83201483",
    ),
    HresultEntry(0x8000FFFF, "E_UNEXPECTED", "fatal error"),
    HresultEntry(0x80004001, "E_NOTIMPL", "function not implemented"),
    HresultEntry(0x80004003, "E_POINTER", "bad pointer"),
    HresultEntry(0x80004004, "E_ABORT", "aborted"),
    HresultEntry(0x80004005, "E_FAIL", "unspecified failure"),
    HresultEntry(
        0x80070005,
        "E_ACCESSDENIED",
        "not allowed",
        "the C client also reports this when a datagram comes from a third address",
    ),
    HresultEntry(
        0x80070006,
        "E_HANDLE",
        "handle is not valid",
        "get a new handle; this one was released, or belongs to another object",
    ),
    HresultEntry(0x8007000E, "E_OUTOFMEMORY", "out of memory"),
    HresultEntry(
        0x80070057,
        "E_INVALIDARG",
        "argument, option or function id is not valid",
        "check provider name, WDT of at least 80 ms, and send format; old firmware refuses newer formats",
    ),
    HresultEntry(
        0x800706BE,
        None,
        "remote procedure call failed (Windows error 1726), seen on Motor off after an abnormal end",
    ),
    HresultEntry(0x80020005, "DISP_E_TYPEMISMATCH", "value of another type than the call takes"),
    HresultEntry(0x80020008, "DISP_E_BADVARTYPE", "VARIANT type is not valid here"),
    HresultEntry(0x8002000A, "DISP_E_OVERFLOW", "value does not fit the type"),
    HresultEntry(0x8002000B, "DISP_E_BADINDEX", "index outside the array"),
    HresultEntry(0x80010000, "E_INVALIDPACKET", "frame is malformed"),
    HresultEntry(
        0x80010001,
        "BCAP_E_INVALIDRCVPACKET",
        "controller received a malformed frame and drops the connection at once",
        "check length, argument count and argument lengths of the request",
    ),
    HresultEntry(0x80010002, "BCAP_E_INVALIDSNDPACKET", "malformed frame sent"),
    HresultEntry(0x80010003, "BCAP_E_INVALIDARGTYPE", "argument type not supported"),
    HresultEntry(0x80010004, "BCAP_E_ROBOTISBUSY", "robot is busy", "repeat the call a little later"),
    HresultEntry(0x80010005, "BCAP_E_INVALIDCOMMAND", "command name not known"),
    HresultEntry(0x80010011, "BCAP_E_PACKETSIZEOVER", "frame of more than 16 MiB"),
    HresultEntry(0x80010012, "BCAP_E_ARGSIZEOVER", "argument of more than 16 MiB"),
    HresultEntry(0x80000200, "E_CAO_SEM_CREATE", "semaphore could not be made"),
    HresultEntry(0x80000201, "E_CAO_PROV_INVALID", "provider name is not valid"),
    HresultEntry(0x80000202, "E_CAO_COMPUTER_NAME", "computer name is not valid"),
    HresultEntry(0x80000203, "E_CAO_VARIANT_TYPE_NOSUPPORT", "VARIANT type not supported"),
    HresultEntry(0x80000204, "E_CAO_OBJECT_NOTFOUND", "object not found"),
    HresultEntry(
        0x80000205,
        "E_CAO_COLLECTION_REGISTERED",
        "name is in use already",
        "Controller_Connect with another name, or with @IfNotMember; release what an earlier run left",
    ),
    HresultEntry(0x80000207, "E_CAO_THREAD_CREATE", "thread could not be made"),
    HresultEntry(0x80000208, "E_CAO_REMOTE_ENGINE", "remote engine failed"),
    HresultEntry(0x80000209, "E_CAO_REMOTE_PROVIDER", "remote provider failed"),
    HresultEntry(0x8000020A, "E_CAO_NOT_WRITABLE", "not writable"),
    HresultEntry(0x8000020B, "E_CAO_CMD_EXECUTE", "command is still running"),
    HresultEntry(0x8000020C, "E_CAO_PROV_NO_LICENSE", "provider has no licence"),
    HresultEntry(0x8000020D, "E_CAO_PRELOAD", "preloading failed"),
    HresultEntry(0x80000400, "E_CRDIMPL", "description file is at fault"),
    HresultEntry(0x80000401, "E_CAOP_SYSTEMNAME_INVALID", "name of the system variable is not valid"),
    HresultEntry(0x80000402, "E_CAOP_SYSTEMTYPE_INVALID", "type of the system variable is not valid"),
    HresultEntry(0x80000403, "E_CANCEL", "cancelled"),
    HresultEntry(0x80000404, "E_CAOP_NOT_WRITABLE", "system variable is not writable"),
    HresultEntry(
        0x80000900,
        "E_TIMEOUT",
        "no matching reply in time",
        "find out whether the request or the reply was lost or late; raise the timeout or set WDT",
    ),
    HresultEntry(0x80000901, "E_NO_LICENSE", "licence missing"),
    HresultEntry(0x80000902, "E_NOT_CONNECTED", "not connected"),
    HresultEntry(0x80000903, "E_NOT_USE", "not usable"),
    HresultEntry(0x80000904, "E_INVALID_CMD_NAME", "command name not known"),
    HresultEntry(
        0x80000905, "E_MAX_OBJECT", "more objects than a client may hold (1000)", "release objects after use"
    ),
    HresultEntry(0x80000906, "E_ALREADY_REGISTER", "registered already"),
    HresultEntry(
        0x80000909,
        "E_TOO_MUCH_DATA",
        "frame larger than the transport allows (503 bytes on UDP), refused before sending",
        "use TCP or shorten the options; some drivers report this also if they cannot connect",
    ),
    HresultEntry(0x8000090B, "E_MAX_CONNECT", "list of clients is full", "close unused connections"),
    HresultEntry(
        0x809100AA,
        None,
        "busy: an earlier call of this connection, or over UDP of any client, still runs (system error 170)",
        "wait for its reply; after InvokeTimeout no reply comes",
    ),
)

SLAVE_MODE_CODES: tuple[HresultEntry, ...] = (
    HresultEntry(
        0x83500121,
        None,
        "slvMove while slave mode is off",
        "look for the error before it: any error switches slave mode off",
    ),
    HresultEntry(
        0x83501032,
        None,
        "command not allowed while slave mode is on",
        "slvChangeMode 0 first; look for a second client that sends commands",
        "2254",
    ),
    HresultEntry(0x83501033, None, "command needs slave mode", "slvChangeMode first"),
    HresultEntry(0x8120174E, None, "not possible in slave mode", "slvChangeMode 0 first"),
    HresultEntry(0x8120184E, None, "possible in slave mode only", "slvChangeMode first"),
    HresultEntry(0x8350009E, None, "slave-mode motion failed", "switch the controller off and on"),
    HresultEntry(
        0x84201482,
        None,
        "no new set point in time: the buffer ran empty while moving, and slave mode is left",
        "send every 8 ms with at most 24 ms of slack; give the loop its own process with real-time priority",
    ),
    HresultEntry(0x83201483, None, "set-point buffer overflow: slvMove came too fast in mode 0", _RESEND),
    HresultEntry(0x83201481, None, "cooperating slave controller is not in slave mode"),
    HresultEntry(0x83201484, None, "cooperating slave controller is not in automatic mode"),
    HresultEntry(0x85201485, None, "no memory for the set-point buffer"),
    HresultEntry(
        0x84201486,
        None,
        "set points abandoned because of an earlier error; axes stopped, motor off",
        _RESTART,
    ),
    HresultEntry(0x8420151C, None, "sending of set points stopped"),
    HresultEntry(0x84201547, None, "sending of set points stopped: irregular set point"),
    HresultEntry(0x80201548, None, "irregular set point"),
    HresultEntry(0x83201405, None, "set point is not valid"),
    HresultEntry(0x83201682, None, "previous set point not sent yet"),
    HresultEntry(0x83201684, None, "servo's set-point buffer is empty"),
    HresultEntry(0x84400502, None, "servo transfer buffer overflow"),
    HresultEntry(0x84400503, None, "servo transfer buffer underflow", None, "671A"),
    HresultEntry(0x84201414, None, "tool-tip speed over the safety limit", _SLOWER),
    HresultEntry(0x84201415, None, "tool-tip speed over the safety limit", _SLOWER),
    HresultEntry(
        0x83201401,
        None,
        "figure (arm posture) of start and target differ",
        "keep Fig of the set points equal to the robot's at the start",
        "607F",
    ),
    HresultEntry(0x83201404, None, "robot is stopping", "wait for standstill", "73FF"),
    HresultEntry(0x80201418, None, "near a singularity"),
    HresultEntry(0x83201530, None, "force control: speed limit"),
    HresultEntry(0x8320155E, None, "set point violates a virtual fence or exclusive area"),
    HresultEntry(0x83201572, None, "set point violates a virtual fence or exclusive area"),
    HresultEntry(0x83201562, None, "set point violates a virtual fence or exclusive area"),
    HresultEntry(
        0x81500177,
        None,
        "operation refused while the b-CAP slave function is enabled",
        "do it before slave mode, or switch the function off",
    ),
    HresultEntry(0x805003F2, None, "pendant's user logged out because slave mode started"),
    HresultEntry(0x803022EF, None, "meaning unknown; seen together with 84201486 on an older controller"),
)

STATE_CODES: tuple[HresultEntry, ...] = (
    HresultEntry(
        0x8150100D,
        None,
        "not possible while the robot moves",
        "end the motion before with @E, or wait for standstill",
        "600B",
    ),
    HresultEntry(
        0x81201744,
        None,
        "not possible while a robot axis moves",
        "end the motion before with @E, or wait for standstill",
        "600B",
    ),
    HresultEntry(0x81501003, None, "motor must be on", "Motor on first", "2006"),
    HresultEntry(0x81501001, None, "not possible with motor on", "Motor off first", "200A"),
    HresultEntry(0x8350106E, None, "motor is still switching off", "repeat Motor on until it is accepted"),
    HresultEntry(0x83500160, None, "switching the motor on took too long"),
    HresultEntry(0x83500161, None, "switching the motor off took too long"),
    HresultEntry(0x83500188, None, "switching the motor on failed"),
    HresultEntry(0x83500193, None, "switching the motor on failed"),
    HresultEntry(
        0x83501024,
        None,
        "arm semaphore not held",
        "TakeArm first; another client or program may hold the arm",
        "21F7",
    ),
    HresultEntry(0x81501025, None, "not possible while an error is active", _CLEAR, "21D3"),
    HresultEntry(0x81201701, None, "not possible while an error is active", _CLEAR, "21D3"),
    HresultEntry(0x81201749, None, "not possible while an error is active", _CLEAR, "21D3"),
    HresultEntry(0x81501005, None, "not possible with machine lock on", None, "21DE"),
    HresultEntry(0x81201705, None, "not possible with machine lock on", None, "21DE"),
    HresultEntry(0x81201748, None, "not possible with machine lock on", None, "21DE"),
    HresultEntry(0x81501007, None, "machine lock must be on", None, "21DF"),
    HresultEntry(0x81501012, None, "not possible in manual mode", _AUTO, "21E2"),
    HresultEntry(0x81501013, None, "possible in manual mode only", _AUTO, "21E3"),
    HresultEntry(0x81501014, None, "not possible in teach-check mode", _AUTO, "21E4"),
    HresultEntry(0x81501015, None, "possible in teach-check mode only", _AUTO, "21E5"),
    HresultEntry(0x81501016, None, "not possible in automatic mode", _AUTO, "21E6"),
    HresultEntry(0x81501017, None, "possible in automatic mode only", _AUTO, "21E7"),
    HresultEntry(0x8150101A, None, "emergency stop is on", "release it", "2008"),
    HresultEntry(0x8120170A, None, "emergency stop is on", "release it", "2008"),
    HresultEntry(0x83500178, None, "emergency stop is on", "release it before ManualReset and the like"),
    HresultEntry(0x81501020, None, "auto-enable must be off", None, "21F2"),
    HresultEntry(0x81501021, None, "auto-enable must be on", None, "21F3"),
    HresultEntry(0x8150101C, None, "instant stop is on", None, "21EE"),
    HresultEntry(0x8150101E, None, "step stop is on", None, "21F0"),
    HresultEntry(0x81501022, None, "protective stop is on"),
    HresultEntry(0x81501023, None, "protective stop must be on"),
    HresultEntry(0x8150100A, None, "a program is running", None, "71E0"),
    HresultEntry(0x81501011, None, "programs are being stopped", None, "73FF"),
    HresultEntry(0x83501035, None, "programs are being stopped", None, "73FF"),
    HresultEntry(0x82501009, None, "a fatal error (level 5) came just before", None, "27A6"),
    HresultEntry(0x83501026, None, "start permission (executable token) must be the pendant's"),
    HresultEntry(0x83501027, None, "start permission (executable token) must be the I/O's", None, "2289"),
    HresultEntry(
        0x83501028,
        None,
        "start permission (executable token) must be Ethernet's",
        "set the executable token to Ethernet with this client's address on the pendant",
        "2287",
    ),
    HresultEntry(
        0x83501029,
        None,
        "address of the start permission (executable token) not set",
        "enter this client's address on the pendant",
        "2288",
    ),
    HresultEntry(0x80501043, None, "no communication right to read"),
    HresultEntry(0x80501044, None, "no communication right to write"),
    HresultEntry(0x81501078, None, "safety state is active", "ManualReset"),
    HresultEntry(0x83501079, None, "recovery state is active", "ManualReset"),
    HresultEntry(0x81501069, None, "motion preparation needed", "MotionPreparation"),
    HresultEntry(0x81501070, None, "motion preparation needed", "MotionPreparation"),
    HresultEntry(
        0x83500372,
        None,
        "ManualResetPreparation missing before MotionPreparation or ClearError",
        "ManualResetPreparation first",
    ),
    HresultEntry(0x8350013F, None, "b-CAP connection failed"),
    HresultEntry(0x82201F8F, None, "b-CAP connection failed"),
    HresultEntry(0x82201F91, None, "b-CAP connection option is not valid"),
    HresultEntry(0x82201F92, None, "b-CAP connection timed out"),
    HresultEntry(0x82201692, None, "b-CAP servo connection failed"),
    HresultEntry(0x82201694, None, "b-CAP servo connection timed out"),
    HresultEntry(0x83500009, None, "licence not registered"),
    HresultEntry(0x83500126, None, "licence not registered"),
    HresultEntry(0x81500109, None, "access denied"),
    HresultEntry(0x8150012D, None, "timeout elapsed"),
    HresultEntry(0x81500151, None, "timeout elapsed"),
    HresultEntry(0x83500162, None, "communication with the PC lost", None, "25E2"),
    HresultEntry(0x83500127, None, "value out of range", None, "2003"),
    HresultEntry(0x8350048F, None, "gripper found nothing"),
    HresultEntry(0x835002FF, None, "hand command was stopped"),
    HresultEntry(0x83500301, None, "hand is already moving", "wait for the end of the motion before"),
    HresultEntry(0x83500314, None, "hand settings are out of range", "check width, speed and force"),
    HresultEntry(0x83500362, None, "grip ends outside the hand's limits"),
    HresultEntry(0x83500363, None, "grip ends outside the hand's limits"),
    HresultEntry(0x8450031C, None, "hand position deviates too much", "grip with HandMoveH or HandMoveAH"),
    HresultEntry(0x83500189, None, "SyncTimeEnd is missing"),
    HresultEntry(0x83500190, None, "SyncMoveEnd is missing"),
    HresultEntry(0x83500191, None, "SyncTimeEnd without SyncTimeStart"),
    HresultEntry(0x83500192, None, "SyncMoveEnd without SyncMoveStart"),
)

AXIS_FAMILIES: tuple[AxisFamily, ...] = (
    AxisFamily(0x82204020, "commanded speed too high (warning)", _SLOWER),
    AxisFamily(0x84204040, "commanded acceleration too high", _SLOWER),
    AxisFamily(0x84204050, "commanded speed over the limit at the servo interface", _SLOWER),
    AxisFamily(0x84204060, "commanded speed over the limit", _SLOWER),
    AxisFamily(0x84204080, "commanded speed over the limit", _SLOWER),
    AxisFamily(0x84204090, "commanded speed over the limit", _SLOWER),
    AxisFamily(0x842040A0, "commanded speed over the limit", _SLOWER),
    AxisFamily(0x84204250, "commanded speed over the limit", _SLOWER),
    AxisFamily(0x84204310, "commanded acceleration over the limit", _SLOWER),
    AxisFamily(0x84204370, "commanded acceleration over the limit", _SLOWER),
    AxisFamily(0x83204070, "beyond its software limit", _LIMIT),
    AxisFamily(0x83204230, "commanded position beyond the software limit; axes stopped, motor off", _LIMIT),
    AxisFamily(0x82204240, "commanded position beyond the software limit; axes stopped, motor off", _LIMIT),
    AxisFamily(0x81204120, "commanded position beyond the software limit; axes stopped, motor off", _LIMIT),
    AxisFamily(0x83404D10, "set point out of range (servo)", _LIMIT),
)

CODE_RANGES: tuple[CodeRange, ...] = (
    CodeRange(0x80070000, 0x8007FFFF, "Windows error {number}"),
    CodeRange(0x80910000, 0x8091FFFF, "socket error {number} of the operating system"),
    CodeRange(
        0x81500142,
        0x8150015A,
        "error of the CAO engine (provider, type, object, timeout or handle), as controller programs see it",
    ),
    CodeRange(0x80000200, 0x800002FF, "error of the CAO engine"),
    CodeRange(0x80000400, 0x800004FF, "error of a CAO provider"),
    CodeRange(0x80000900, 0x800009FF, "error of the ORiN library"),
    CodeRange(0x80004000, 0x80004FFF, "error of a COM interface"),
    CodeRange(0x80010000, 0x8001FFFF, "error of the b-CAP library"),
    CodeRange(0x80020000, 0x8002FFFF, "error of the VARIANT conversion"),
)

_RC7_ENCODER = tuple(
    HresultEntry(0x6410 + axis, None, f"J{axis}: encoder backup lost", None, f"641{axis}")
    for axis in range(1, 9)
)

RC7_CODES: tuple[HresultEntry, ...] = (
    HresultEntry(
        0x600B,
        None,
        "robot is running: slvChangeMode waited more than 500 ms for standstill",
        "end the motion before with @E, or wait for standstill",
        "600B",
    ),
    HresultEntry(0x21FC, None, "auto-enable signal", None, "21FC"),
    *_RC7_ENCODER,
)
"""Four-digit codes of RC7 that RC7's own papers explain."""

RC7_LEVELS: dict[int, int] = {0x600B: 1, **{entry.code: 5 for entry in _RC7_ENCODER}}
"""Error levels of the codes in `RC7_CODES` whose level the papers print, by the code."""
