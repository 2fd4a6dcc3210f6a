-- Decode the bytes of one frame, with the rules and the limits of `bcapscope decode`.
--
-- This part uses nothing of Wireshark. All offsets count from 0.
--
-- Exports: u16, u32, message, counted, type_name, string_text, has_compressed_header, brief_frame, decode_frame

function u16(raw, at)
    local a, b = byte(raw, at + 1, at + 2)
    return a + b * 256
end

function u32(raw, at)
    local a, b, c, d = byte(raw, at + 1, at + 4)
    return a + b * 256 + c * 65536 + d * 16777216
end

-- Return a text of `TEXTS` with its places filled in.
function message(id, places)
    return (TEXTS[id]:gsub("{(%w+)[^}]*}", function(name)
        local value = places[name]
        return type(value) == "number" and ("%d"):format(value) or value
    end))
end

function counted(count, unit)
    return (COUNTS[unit][count == 1 and 1 or 2]:gsub("{n}", ("%d"):format(count)))
end

local function is_array_type(vt) return floor(vt / ARRAY) % 2 == 1 end

function type_name(vt)
    local base = is_array_type(vt) and vt - ARRAY or vt
    local name = TYPE_NAMES[base] or ("VT_0x%04X"):format(base)
    return base == vt and name or name .. "|VT_ARRAY"
end

local function utf8_char(code)
    if code < 0x80 then return string.char(code) end
    if code < 0x800 then return string.char(0xC0 + floor(code / 64), 0x80 + code % 64) end
    if code < 0x10000 then
        return string.char(0xE0 + floor(code / 4096), 0x80 + floor(code / 64) % 64, 0x80 + code % 64)
    end
    return string.char(0xF0 + floor(code / 262144), 0x80 + floor(code / 4096) % 64, 0x80 + floor(code / 64) % 64,
        0x80 + code % 64)
end

local MAX_TEXTS = 4096
local known_texts, known_text_count = {}, 0

-- Return UTF-16 as UTF-8. Wireshark's texts hold no NUL, which becomes U+2400, and no lone surrogate, which
-- becomes U+FFFD.
local function decode_utf16(raw)
    local known = known_texts[raw]
    if known then return known end
    local parts, at, size = {}, 0, #raw - #raw % 2
    while at < size do
        local unit = u16(raw, at)
        at = at + 2
        if unit == 0 then
            unit = 0x2400
        elseif unit >= 0xD800 and unit < 0xE000 then
            local low = unit < 0xDC00 and at < size and u16(raw, at) or 0
            if low >= 0xDC00 and low < 0xE000 then
                unit = 0x10000 + (unit - 0xD800) * 1024 + low - 0xDC00
                at = at + 2
            else
                unit = 0xFFFD
            end
        end
        parts[#parts + 1] = utf8_char(unit)
    end
    local text = table.concat(parts)
    if known_text_count >= MAX_TEXTS then known_texts, known_text_count = {}, 0 end
    known_texts[raw], known_text_count = text, known_text_count + 1
    return text
end

-- The reader of a frame's arguments. `stop` is the offset after the last byte that an argument can have,
-- `value_stop` that of the value being read.

local function add_problem(reader, offset, code, reason)
    local problems = reader.problems
    if #problems < MAX_PROBLEMS then
        problems[#problems + 1] = { offset = offset, code = code, reason = reason }
    elseif #problems == MAX_PROBLEMS then
        problems[#problems + 1] = { offset = offset, code = "more", reason = message("problem.more", { n = MAX_PROBLEMS }) }
    end
end

local function lose_position(reader, offset, code, reason)
    add_problem(reader, offset, code, reason)
    reader.is_lost = true
end

local function stop_at_limit(reader, reason)
    reader.is_limited = true
    lose_position(reader, reader.pos, "elements", reason)
end

local function count_value(reader)
    if reader.values_left == 0 then
        stop_at_limit(reader, message("problem.elements.values", { n = MAX_VALUES }))
        return false
    end
    reader.values_left = reader.values_left - 1
    return true
end

local function report_missing_data(reader, count, vt, present)
    lose_position(reader, reader.pos, "data", message("problem.data.elements",
        { elements = counted(count, "element"), type = type_name(vt), present = present }))
end

local function read_numbers(reader, node, base, count)
    local width = WIDTHS[base]
    local present = math.min(count, floor((reader.value_stop - reader.pos) / width))
    local fits = math.min(present, reader.numbers_left)
    reader.numbers_left = reader.numbers_left - fits
    node.numbers = { at = reader.pos, count = fits }
    reader.pos = reader.pos + fits * width
    if fits < present then
        stop_at_limit(reader, message("problem.elements.numbers", { n = MAX_NUMBERS }))
    elseif present < count then
        report_missing_data(reader, count, base, present)
    end
end

local function read_number(reader, node, base)
    local width = WIDTHS[base]
    if reader.value_stop - reader.pos < width then return report_missing_data(reader, 1, base, 0) end
    node.numbers = { at = reader.pos, count = 1 }
    reader.pos = reader.pos + width
end

local function read_bytes(reader, node, count)
    local start = reader.pos
    reader.pos = math.min(start + count, reader.value_stop)
    if reader.pos < start + count then report_missing_data(reader, count, UI1, reader.pos - start) end
    node.bytes = { at = start, size = reader.pos - start }
end

-- Return where a string and its length field are; nil without length field.
local function read_string(reader)
    local at = reader.pos
    if reader.value_stop - at < 4 then
        return lose_position(reader, at, "data", message("problem.data.string-length", {}))
    end
    local size = u32(reader.raw, at)
    local start = at + 4
    local stop = math.min(start + size, reader.value_stop)
    if size % 2 == 1 then add_problem(reader, at, "string", message("problem.string", { size = size })) end
    if stop < start + size then
        lose_position(reader, at, "data", message("problem.data.string", { size = size, present = stop - start }))
    end
    reader.pos = stop
    return { at = at, size = stop - start }
end

function string_text(raw, place)
    return decode_utf16(sub(raw, place.at + 5, place.at + 4 + place.size))
end

local read_variant

local function read_variants(reader, node, count, depth)
    node.variants = {}
    if depth == MAX_NESTING then
        return lose_position(reader, reader.pos, "nesting", message("problem.nesting", { depth = MAX_NESTING }))
    end
    local variants = node.variants
    while #variants < count and not reader.is_lost do
        if reader.value_stop - reader.pos < 6 then
            return report_missing_data(reader, count, VARIANT, #variants)
        end
        if not count_value(reader) then return end
        variants[#variants + 1] = read_variant(reader, depth + 1)
    end
end

local function read_array(reader, node, base, count, depth)
    if base == UI1 then
        read_bytes(reader, node, count)
    elseif WIDTHS[base] then
        read_numbers(reader, node, base, count)
    elseif base == BSTR then
        node.strings = {}
        while #node.strings < count and not reader.is_lost and count_value(reader) do
            node.strings[#node.strings + 1] = read_string(reader)
        end
    elseif base == VARIANT then
        read_variants(reader, node, count, depth)
    else
        lose_position(reader, reader.pos - 6, "type", message("problem.type", { type = type_name(base + ARRAY) }))
        node.is_unknown = true
    end
end

function read_variant(reader, depth)
    local start = reader.pos
    local vt, count = u16(reader.raw, start), u32(reader.raw, start + 2)
    local node = { at = start, vt = vt, count = count }
    reader.pos = start + 6
    if is_array_type(vt) then
        node.is_array = true
        node.base = vt - ARRAY
        read_array(reader, node, node.base, count, depth)
        node.stop = reader.pos
        return node
    end
    node.base = vt
    if WIDTHS[vt] then
        read_number(reader, node, vt)
    elseif vt == BSTR then
        node.text = read_string(reader)
    elseif vt > NULL then
        lose_position(reader, start, "type", message("problem.type", { type = type_name(vt) }))
        node.is_unknown = true
        node.stop = reader.pos
        return node
    end
    if count ~= 1 and vt > NULL then
        add_problem(reader, start + 2, "count", message("problem.count", { n = count }))
    end
    node.stop = reader.pos
    return node
end

local function read_value(reader, start, stop)
    reader.pos, reader.value_stop, reader.is_lost = start + 4, stop, false
    return read_variant(reader, 0)
end

-- Read an argument; return whether the start of the next argument is known. The next argument begins where the
-- value ends. If a value cannot be read, the length fields count from then on.
local function read_argument(reader)
    local start = reader.pos
    local claimed = u32(reader.raw, start)
    local stop = start + 4 + claimed
    local is_bounded = claimed >= SMALLEST_ARGUMENT - 4 and stop <= reader.stop
    local known, numbers, values = #reader.problems, reader.numbers_left, reader.values_left
    local node = read_value(reader, start, is_bounded and reader.trusts_lengths and stop or reader.stop)
    if reader.is_lost and is_bounded and stop < reader.stop and not reader.trusts_lengths then
        reader.trusts_lengths, reader.is_limited = true, false
        for index = #reader.problems, known + 1, -1 do reader.problems[index] = nil end
        reader.numbers_left, reader.values_left = numbers, values
        node = read_value(reader, start, stop)
    end
    if reader.is_lost then
        reader.pos = is_bounded and stop or reader.stop
        if node.is_unknown or node.bytes and node.bytes.size == 0 then
            node.bytes = nil
            node.raw = { at = start + SMALLEST_ARGUMENT, size = reader.pos - start - SMALLEST_ARGUMENT }
        end
    elseif reader.pos ~= stop then
        add_problem(reader, start, "argument-length",
            message("problem.argument-length", { claimed = claimed, taken = reader.pos - start - 4 }))
    end
    node.start, node.stop = start, reader.pos
    reader.arguments[#reader.arguments + 1] = node
    return not reader.is_limited and (is_bounded or not reader.is_lost)
end

local function read_arguments(reader, argc)
    for index = 0, argc - 1 do
        if reader.stop - reader.pos < SMALLEST_ARGUMENT then
            return add_problem(reader, reader.pos, "argc", message("problem.argc", { claimed = argc, present = index }))
        end
        if not (count_value(reader) and read_argument(reader)) then return end
    end
    reader.is_complete = true
end

-- Exclusive or, by tables, because Lua 5.2 has no operator for it

local NIBBLES = {}
for a = 0, 15 do
    for b = 0, 15 do
        local result = 0
        for bit = 0, 3 do
            if floor(a / 2 ^ bit) % 2 ~= floor(b / 2 ^ bit) % 2 then result = result + 2 ^ bit end
        end
        NIBBLES[a * 16 + b] = floor(result)
    end
end

local function xor_byte(a, b)
    local low_a, low_b = a % 16, b % 16
    return NIBBLES[a - low_a + (b - low_b) / 16] * 16 + NIBBLES[low_a * 16 + low_b]
end

-- High and low byte of the CRC of each byte
local CRC_HIGH, CRC_LOW = {}, {}
for value = 0, 255 do
    local high, low = value, 0
    for _ = 1, 8 do
        local is_set = high >= 128
        high, low = high % 128 * 2 + floor(low / 128), low % 128 * 2
        if is_set then high, low = xor_byte(high, 0x10), xor_byte(low, 0x21) end
    end
    CRC_HIGH[value], CRC_LOW[value] = high, low
end

-- Return the CRC-16 of a serial-line frame: polynomial 0x1021, start value 0xFFFF.
local function crc16(data)
    local high, low = 255, 255
    for index = 1, #data do
        local value = xor_byte(high, byte(data, index))
        high, low = xor_byte(low, CRC_HIGH[value]), CRC_LOW[value]
    end
    return high * 256 + low
end

-- Determine the framing from the bytes between the last argument and EOT.
local function read_tail(frame, reader)
    local body, size = frame.body, reader.stop - reader.pos
    local is_plain = frame.framing == "plain"
    if is_plain and size == 1 and byte(body, reader.pos + 1) == 0 and u16(body, 7) == 1 then
        frame.framing = "version 1"
    elseif is_plain and size == 2 and u16(body, reader.pos) == crc16(sub(body, 2, reader.pos)) then
        frame.framing = "serial line"
    else
        local problems = reader.problems
        problems[#problems + 1] = { offset = reader.pos, code = "left-over",
            reason = message("problem.left-over", { bytes = counted(size, "byte") }) }
    end
end

function has_compressed_header(raw, at)
    local method, flags = byte(raw, at + 14, at + 15)
    return u16(raw, at + 7) == 1 and method < 128 and method % 16 == 8 and (method * 256 + flags) % 31 == 0
end

-- Unpack the body of a compressed frame of version 1, if it is one.
local function unpack_body(frame, problems)
    local raw = frame.raw
    local size = #raw
    if size <= HEADER_SIZE + 2 or not has_compressed_header(raw, 0) or sub(raw, -2) ~= "\1\4" then return end
    local claimed = u32(raw, 9)
    local data, is_whole, has_more = inflate(sub(raw, 14, -3), LARGEST_UNPACKED + 1)
    if not data or #data < 6 then return end
    local function add(offset, code, reason) problems[#problems + 1] = { offset = offset, code = code, reason = reason } end
    if #data > LARGEST_UNPACKED then
        data = sub(data, 1, LARGEST_UNPACKED)
        add(13, "unpacked", message("problem.unpacked.too-large", { size = LARGEST_UNPACKED }))
    elseif not is_whole then
        add(13, "unpacked", message("problem.unpacked.early", {}))
    elseif #data ~= claimed then
        add(9, "unpacked", message("problem.unpacked.size", { claimed = claimed, present = #data }))
    end
    if has_more then add(13, "left-over", message("problem.left-over.compressed", {})) end
    frame.framing = "version 1, zlib"
    frame.body = sub(raw, 1, 9) .. data .. sub(raw, -1)
    frame.code = u32(frame.body, 9)
end

local function sorted_by_offset(head, rest)
    local sorted = head
    for _, problem in ipairs(rest) do sorted[#sorted + 1] = problem end
    for index, problem in ipairs(sorted) do problem.index = index end
    if #sorted > 1 then
        table.sort(sorted, function(a, b)
            if a.offset ~= b.offset then return a.offset < b.offset end
            return a.index < b.index
        end)
    end
    return sorted
end

-- Return the command of an ..._Execute request; nil without one.
local function command_of(frame)
    local node = COMMAND_FUNCTIONS[frame.code] and frame.arguments[2]
    return node and node.text and string_text(frame.body, node.text) or nil
end

-- Sound frames that differ only in serial, reserved and the numbers of their last argument share a shape. A
-- frame of a known shape needs no decoding for the packet list, which takes a tenth of the time.
local MAX_SHAPES = 4096
local shapes_by_size, shape_count = {}, 0
local NO_PROBLEMS = {}
local brief = { problems = NO_PROBLEMS }

local function learn_shape(frame)
    local size, last = #frame.raw, frame.arguments[#frame.arguments]
    if #frame.problems > 0 or frame.framing ~= "plain" or frame.argc > 255 then return end
    if shape_count >= MAX_SHAPES then shapes_by_size, shape_count = {}, 0 end
    local shapes = shapes_by_size[size] or {}
    shapes_by_size[size] = shapes
    shapes.stop = last and last.numbers and last.numbers.at or size - 1
    shapes[sub(frame.raw, 10, shapes.stop)] = command_of(frame) or false
    shape_count = shape_count + 1
end

-- Return what the bytes of a frame hold. `raw` has at least `HEADER_SIZE` bytes.
function decode_frame(raw)
    local size, length = #raw, u32(raw, 1)
    local frame = { raw = raw, body = raw, framing = "plain", length = length, serial = u16(raw, 5),
        reserved = u16(raw, 7), code = u32(raw, 9) }
    local head = {}
    if byte(raw, 1) ~= SOH then
        head[1] = { offset = 0, code = "soh", reason = message("problem.soh", { byte = ("%02X"):format(byte(raw, 1)) }) }
    end
    if length ~= size then
        head[#head + 1] = { offset = 1, code = "length",
            reason = message("problem.length", { claimed = length, present = size }) }
    end
    if frame.reserved == 1 then unpack_body(frame, head) end
    local body = frame.body
    size = #body
    local last = byte(body, size)
    local has_eot = size > HEADER_SIZE and last == EOT
    local stop = (has_eot or size > HEADER_SIZE and length == size) and size - 1 or size
    local reader = { raw = body, pos = HEADER_SIZE, stop = stop, arguments = {}, problems = {},
        numbers_left = MAX_NUMBERS, values_left = MAX_VALUES }
    frame.argc = u16(body, 13)
    read_arguments(reader, frame.argc)
    if reader.pos < stop and reader.is_complete then read_tail(frame, reader) end
    local problems = reader.problems
    if size <= HEADER_SIZE then
        problems[#problems + 1] = { offset = size, code = "eot", reason = message("problem.eot.missing", {}) }
    elseif not has_eot then
        problems[#problems + 1] = { offset = size - 1, code = "eot",
            reason = message("problem.eot", { byte = ("%02X"):format(last) }) }
    end
    frame.arguments = reader.arguments
    frame.problems = sorted_by_offset(head, problems)
    frame.command = command_of(frame)
    learn_shape(frame)
    return frame
end

-- Return header and command of a frame, without its arguments. The next call overwrites the table.
function brief_frame(raw)
    local size = #raw
    local shapes = shapes_by_size[size]
    local command
    if shapes then command = shapes[sub(raw, 10, shapes.stop)] end
    if command == nil then return nil end
    local soh, l1, l2, l3, l4, s1, s2, r1, r2, c1, c2, c3, c4 = byte(raw, 1, 13)
    if soh ~= SOH or byte(raw, size) ~= EOT or l1 + l2 * 256 + l3 * 65536 + l4 * 16777216 ~= size then return nil end
    brief.raw, brief.serial, brief.reserved = raw, s1 + s2 * 256, r1 + r2 * 256
    brief.code, brief.command = c1 + c2 * 256 + c3 * 65536 + c4 * 16777216, command or nil
    return brief
end
