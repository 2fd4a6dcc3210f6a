-- b-CAP for Wireshark, the peer that `decode.py` measures against.
--
-- Header, function id or result, and every argument with its type go into the tree, arrays element by
-- element; the info column names function and command. A frame does not tell request from reply, the port
-- does. Layout and type numbers: orin_bcap, C/include/bcap_common.h and C/src/bcap_common.c.
--
-- tshark -X lua_script:bcap.lua -r slave.pcap

local PORT = 5007
local ARRAY = 0x2000
local BSTR, VARIANT = 8, 12
local MAX_DEPTH = 32

-- class, first id, then the functions in the order of their ids
local CLASSES = {
    { "Service", 1, "Start Stop" },
    { "Controller", 3, "Connect Disconnect GetExtension GetFile GetRobot GetTask GetVariable GetCommand "
        .. "GetExtensionNames GetFileNames GetRobotNames GetTaskNames GetVariableNames GetCommandNames "
        .. "Execute GetMessage GetAttribute GetHelp GetName GetTag PutTag GetID PutID" },
    { "Extension", 26, "GetVariable GetVariableNames Execute GetAttribute GetHelp GetName GetTag PutTag "
        .. "GetID PutID Release" },
    { "File", 37, "GetFile GetVariable GetFileNames GetVariableNames Execute Copy Delete Move Run "
        .. "GetDateCreated GetDateLastAccessed GetDateLastModified GetPath GetSize GetType GetValue PutValue "
        .. "GetAttribute GetHelp GetName GetTag PutTag GetID PutID Release" },
    { "Robot", 62, "GetVariable GetVariableNames Execute Accelerate Change Chuck Drive GoHome Halt Hold Move "
        .. "Rotate Speed Unchuck Unhold GetAttribute GetHelp GetName GetTag PutTag GetID PutID Release" },
    { "Task", 85, "GetVariable GetVariableNames Execute Start Stop Delete GetFileName GetAttribute GetHelp "
        .. "GetName GetTag PutTag GetID PutID Release" },
    { "Variable", 100, "GetDateTime GetValue PutValue GetAttribute GetHelp GetName GetTag PutTag GetID PutID "
        .. "GetMicrosecond Release" },
    { "Command", 112, "Execute Cancel GetTimeout PutTimeout GetState GetParameters PutParameters GetResult "
        .. "GetAttribute GetHelp GetName GetTag PutTag GetID PutID Release" },
    { "Message", 128, "Reply Clear GetDateTime GetDescription GetDestination GetNumber GetSerialNumber "
        .. "GetSource GetValue Release" },
}
local FUNCTIONS = {}
for _, class in ipairs(CLASSES) do
    local id = class[2]
    for name in class[3]:gmatch("%S+") do
        FUNCTIONS[id] = class[1] .. "_" .. name
        id = id + 1
    end
end

local TYPE_NAMES = {
    [0] = "VT_EMPTY", "VT_NULL", "VT_I2", "VT_I4", "VT_R4", "VT_R8", "VT_CY", "VT_DATE", "VT_BSTR",
    [10] = "VT_ERROR", [11] = "VT_BOOL", [12] = "VT_VARIANT", [17] = "VT_UI1", [18] = "VT_UI2",
    [19] = "VT_UI4", [20] = "VT_I8", [21] = "VT_UI8",
}
local names_with_arrays = {}
for vt, name in pairs(TYPE_NAMES) do
    names_with_arrays[vt] = name
    names_with_arrays[vt + ARRAY] = name .. "|VT_ARRAY"
end
local RESULTS = {
    [0] = "S_OK", [1] = "S_FALSE", [0x900] = "S_EXECUTING", [0x0F200501] = "S_BUF_FULL",
    [0x80004001] = "E_NOTIMPL", [0x80004005] = "E_FAIL", [0x80070005] = "E_ACCESSDENIED",
    [0x80070006] = "E_HANDLE", [0x80070057] = "E_INVALIDARG", [0x8000FFFF] = "E_UNEXPECTED",
}

local bcap = Proto("bcap", "DENSO b-CAP")
local f = {
    length = ProtoField.uint32("bcap.length", "Length"),
    serial = ProtoField.uint16("bcap.serial", "Serial"),
    reserved = ProtoField.uint16("bcap.reserved", "Reserved"),
    func = ProtoField.uint32("bcap.function", "Function", base.DEC, FUNCTIONS),
    hresult = ProtoField.uint32("bcap.hresult", "HRESULT", base.HEX, RESULTS),
    argc = ProtoField.uint16("bcap.argc", "Argument count"),
    arg = ProtoField.none("bcap.arg", "Argument"),
    arg_length = ProtoField.uint32("bcap.arg.length", "Length"),
    vt = ProtoField.uint16("bcap.arg.type", "Type", base.HEX, names_with_arrays),
    count = ProtoField.uint32("bcap.arg.count", "Count"),
    bytes = ProtoField.uint32("bcap.arg.bytes", "Byte length"),
    bstr = ProtoField.string("bcap.arg.bstr", "VT_BSTR"),
    raw = ProtoField.bytes("bcap.arg.raw", "Bytes"),
    command = ProtoField.string("bcap.command", "Command"),
}
-- type number -> bytes of an element and the field that shows it
local SCALARS = {
    [2] = { 2, ProtoField.int16("bcap.arg.i2", "VT_I2") },
    [3] = { 4, ProtoField.int32("bcap.arg.i4", "VT_I4") },
    [4] = { 4, ProtoField.float("bcap.arg.r4", "VT_R4") },
    [5] = { 8, ProtoField.double("bcap.arg.r8", "VT_R8") },
    [6] = { 8, ProtoField.int64("bcap.arg.cy", "VT_CY") },
    [7] = { 8, ProtoField.double("bcap.arg.date", "VT_DATE") },
    [10] = { 4, ProtoField.int32("bcap.arg.error", "VT_ERROR") },
    [11] = { 2, ProtoField.int16("bcap.arg.bool", "VT_BOOL") },
    [17] = { 1, ProtoField.uint8("bcap.arg.ui1", "VT_UI1") },
    [18] = { 2, ProtoField.uint16("bcap.arg.ui2", "VT_UI2") },
    [19] = { 4, ProtoField.uint32("bcap.arg.ui4", "VT_UI4") },
    [20] = { 8, ProtoField.int64("bcap.arg.i8", "VT_I8") },
    [21] = { 8, ProtoField.uint64("bcap.arg.ui8", "VT_UI8") },
}
local malformed = ProtoExpert.new("bcap.malformed", "Malformed", expert.group.MALFORMED, expert.severity.ERROR)
local fields = {}
for _, field in pairs(f) do fields[#fields + 1] = field end
for _, scalar in pairs(SCALARS) do fields[#fields + 1] = scalar[2] end
bcap.fields = fields
bcap.experts = { malformed }

-- Each of these adds what stands at `at` to `tree` and returns where it ends, nil if it runs over `stop`,
-- and, for a single string, its text.

local function add_string(tvb, tree, at, stop)
    if at + 4 > stop then return nil end
    local size = tvb(at, 4):le_uint()
    if at + 4 + size > stop then return nil end
    local text = size > 0 and tvb(at + 4, size):le_ustring() or ""
    tree:add_le(f.bytes, tvb(at, 4))
    tree:add(f.bstr, tvb(at + 4, size), text)
    return at + 4 + size, text
end

local add_variant

local function add_elements(tvb, tree, vt, count, at, stop, depth)
    local scalar, text = SCALARS[vt], nil
    if scalar then
        local size, field = scalar[1], scalar[2]
        if at + size * count > stop then return nil end
        for offset = at, at + size * (count - 1), size do tree:add_le(field, tvb(offset, size)) end
        return at + size * count
    end
    for _ = 1, count do
        if vt == BSTR then
            at, text = add_string(tvb, tree, at, stop)
        elseif vt == VARIANT then
            at = add_variant(tvb, tree, at, stop, depth + 1)
        end
        if not at then return nil end
        if at >= stop then break end
    end
    return at, text
end

function add_variant(tvb, tree, at, stop, depth)
    if at + 6 > stop or depth > MAX_DEPTH then return nil end
    local vt, count = tvb(at, 2):le_uint(), tvb(at + 2, 4):le_uint()
    tree:add_le(f.vt, tvb(at, 2))
    tree:add_le(f.count, tvb(at + 2, 4))
    if vt < 2 then return at + 6 end
    local is_array = vt >= ARRAY
    return add_elements(tvb, tree, is_array and vt - ARRAY or vt, is_array and count or 1, at + 6, stop, depth)
end

local function add_argument(tvb, tree, at, stop)
    if at + 10 > stop then return nil end
    local size = tvb(at, 4):le_uint()
    local ends = at + 4 + size
    if size < 6 or ends > stop then return nil end
    local item = tree:add(f.arg, tvb(at, 4 + size))
    item:add_le(f.arg_length, tvb(at, 4))
    local done, text = add_variant(tvb, item, at + 4, ends, 0)
    if done ~= ends then
        if done then item:add(f.raw, tvb(done, ends - done)) end
        item:add_proto_expert_info(malformed)
    end
    return ends, text
end

local function add_frame(tvb, pinfo, tree)
    local length = tvb(1, 4):le_uint()
    local item = tree:add(bcap, tvb(0, length))
    item:add_le(f.length, tvb(1, 4))
    item:add_le(f.serial, tvb(5, 2))
    item:add_le(f.reserved, tvb(7, 2))
    local code = tvb(9, 4):le_uint()
    local is_request = pinfo.dst_port == PORT
    item:add_le(is_request and f.func or f.hresult, tvb(9, 4))
    item:add_le(f.argc, tvb(13, 2))
    local at, stop, command, text = 15, length - 1, nil, nil
    for index = 1, tvb(13, 2):le_uint() do
        at, text = add_argument(tvb, item, at, stop)
        if not at then
            item:add_proto_expert_info(malformed)
            break
        end
        if index == 2 then command = text end
    end
    local name
    if is_request then
        name = FUNCTIONS[code] or ("Unknown(" .. code .. ")")
        if command and name:sub(-8) == "_Execute" then
            item:add(f.command, command):set_generated()
            name = name .. " " .. command
        end
    else
        name = RESULTS[code] or string.format("0x%08X", code)
    end
    return string.format("%s serial=%d reserved=%d", name, tvb(5, 2):le_uint(), tvb(7, 2):le_uint())
end

local function dissect_datagram(tvb, pinfo, tree)
    local info, at, size = {}, 0, tvb:len()
    while at < size do
        local rest = tvb(at):tvb()
        if rest:len() < 16 or rest(0, 1):uint() ~= 1 then break end
        local length = rest(1, 4):le_uint()
        if length < 16 or length > rest:len() or rest(length - 1, 1):uint() ~= 4 then break end
        info[#info + 1] = add_frame(rest, pinfo, tree)
        at = at + length
    end
    if at < size then
        tree:add(bcap, tvb(at)):add_proto_expert_info(malformed)
        info[#info + 1] = "Malformed"
    end
    pinfo.cols.protocol = "b-CAP"
    pinfo.cols.info = table.concat(info, ", ")
    return size
end

function bcap.dissector(tvb, pinfo, tree)
    if pinfo.port_type == 3 then return dissect_datagram(tvb, pinfo, tree) end
    dissect_tcp_pdus(tvb, tree, 5, function(part) return math.max(part(1, 4):le_uint(), 16) end, dissect_datagram)
    return tvb:len()
end

DissectorTable.get("udp.port"):add(PORT, bcap)
DissectorTable.get("tcp.port"):add(PORT, bcap)
