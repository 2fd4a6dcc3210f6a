-- The dissector: fields, links between frames, the packet list and the tree.

local bcap = Proto("bcap", "DENSO b-CAP")
bcap.prefs.ports = Pref.range("Ports", DEFAULT_PORT, "UDP and TCP ports of controllers", 65535)

-- Limits of what is kept, whatever the traffic
local MAX_KNOWN, MAX_FLOWS = 4096, 65536

local OFFSET_UNIT = 0x100000000

local field_list = {}
local function field(kind, name, ...)
    local created = ProtoField[kind]("bcap." .. name, ...)
    field_list[#field_list + 1] = created
    return created
end

local kind_field = field("string", "kind", "Kind")
local length_field = field("uint32", "length", "Length")
local serial_field = field("uint16", "serial", "Serial")
local reserved_field = field("uint16", "reserved", "Reserved")
local function_id_field = field("int32", "function_id", "Function", base.DEC, FUNCTION_NAMES)
local function_field = field("string", "function", "Function name")
local command_field = field("string", "command", "Command")
local hresult_field = field("uint32", "hresult", "Result", base.HEX)
local hresult_name_field = field("string", "hresult_name", "Result name")
local hresult_text_field = field("string", "hresult_text", "Meaning of the result")
local argc_field = field("uint16", "argc", "Argument count")
local framing_field = field("string", "framing", "Framing")
local argument_field = field("none", "arg", "Argument")
local element_field = field("none", "arg.element", "Element")
local name_field = field("string", "arg.name", "Name")
local argument_length_field = field("uint32", "arg.length", "Length")
local type_field = field("uint16", "arg.type", "Type", base.HEX, TYPE_NAMES_WITH_ARRAYS)
local count_field = field("uint32", "arg.count", "Element count")
local string_length_field = field("uint32", "arg.string_length", "String length")
local raw_field = field("bytes", "arg.raw", "Bytes")
local bytes_field = field("bytes", "arg.bytes", "VT_UI1|VT_ARRAY")
local text_field = field("string", "arg.bstr", "VT_BSTR")
local slave_mode_field = field("uint32", "slave_mode", "Slave mode", base.HEX, SLAVE_MODES)
local problem_field = field("string", "problems", "Problem")
local problem_code_field = field("string", "problem.code", "Code")
local problem_offset_field = field("uint32", "problem.offset", "Offset in the frame")
local response_in_field = field("framenum", "response_in", "Reply in frame", base.NONE, frametype.RESPONSE)
local response_to_field = field("framenum", "response_to", "Request in frame", base.NONE, frametype.REQUEST)
local rtt_field = field("relative_time", "rtt", "Time since the request")
local retry_of_field = field("framenum", "retry_of", "First attempt in frame", base.NONE, frametype.RETRANS_PREV)
local number_fields = {
    [2] = field("int16", "arg.i2", "VT_I2"),
    [3] = field("int32", "arg.i4", "VT_I4"),
    [4] = field("float", "arg.r4", "VT_R4"),
    [5] = field("double", "arg.r8", "VT_R8"),
    [6] = field("int64", "arg.cy", "VT_CY, in 1/10000"),
    [7] = field("double", "arg.date", "VT_DATE, days since 1899-12-30"),
    [10] = field("int32", "arg.error", "VT_ERROR"),
    [11] = field("bool", "arg.bool", "VT_BOOL"),
    [17] = field("uint8", "arg.ui1", "VT_UI1"),
    [18] = field("uint16", "arg.ui2", "VT_UI2"),
    [19] = field("uint32", "arg.ui4", "VT_UI4"),
    [20] = field("int64", "arg.i8", "VT_I8"),
    [21] = field("uint64", "arg.ui8", "VT_UI8"),
}
local damaged = ProtoExpert.new("bcap.damaged", "Damaged frame", expert.group.MALFORMED, expert.severity.ERROR)
bcap.fields = field_list
bcap.experts = { damaged }

-- Text from the wire must not control a terminal or break a line.
local function printable(text)
    text = text:gsub("[%c\127]", function(char) return ("\\x%02x"):format(byte(char)) end)
    if not text:find("[\194\216\219\220\225\226\239\240\243]") then return text end
    return (text:gsub("[\194-\244][\128-\191]+", UNPRINTABLE))
end

-- Results

local known_results, known_result_count = {}, 0

local function is_failure(code) return code >= 0x80000000 or code >= 0x1000 and code <= 0xFFFF end

-- Return the name of a result code, and its meaning.
local function describe_result(code)
    local known = RESULTS[code] or known_results[code]
    if known then return known[1], known[2] end
    if known_result_count >= MAX_KNOWN then known_results, known_result_count = {}, 0 end
    local name, high, low = ("0x%08X"):format(code), floor(code / 65536), code % 65536
    local text
    for _, range in ipairs(RESULT_RANGES) do
        if code >= range[1] and code <= range[2] then
            text = text or range[3]:gsub("{number}", ("%d"):format(low))
        end
    end
    local level, part = floor(code / 0x1000000) % 16, floor(code / 0x100000) % 16
    if text then
        -- the range gives the meaning
    elseif (high == 0 or high == 0x8000) and low >= 0x1000 then
        text = RC7_RESULTS[low] or message("hresult.rc7", { digits = ("%04X"):format(low) })
    elseif floor(code / 0x10000000) == 8 and TEXTS["hresult.level." .. level] and level + part > 0 and high ~= 0x8091 then
        text = message("hresult.by-digits", { level = level, name = TEXTS["hresult.level." .. level] })
        local part_text = TEXTS["hresult.part." .. part]
        if part_text then text = message("hresult.by-digits.part", { meaning = text, part = part_text }) end
        local axis = code % 16
        if (part == 2 or part == 4) and floor(code / 0x1000) % 16 == 4 and axis >= 1 and axis <= 8 then
            text = message("hresult.by-digits.axis", { meaning = text, axis = axis })
        end
        text = message("hresult.not-listed", { meaning = text })
    else
        text = TEXTS[is_failure(code) and "hresult.failure" or "hresult.success"]
    end
    known_results[code], known_result_count = { name, text }, known_result_count + 1
    return name, text
end

-- Kinds of calls: function and command, one table each

local kinds, kind_count = {}, 0

local function call_kind(function_code, command)
    if kind_count >= MAX_KNOWN then kinds, kind_count = {}, 0 end
    local of_function = kinds[function_code]
    if not of_function then
        of_function = {}
        kinds[function_code] = of_function
    end
    local key = command or false
    local kind = of_function[key]
    if kind then return kind end
    local id = function_code >= 0x80000000 and function_code - 0x100000000 or function_code
    local name = FUNCTION_NAMES[function_code] or ("Unknown(%d)"):format(id)
    kind = { id = id, name = name, command = command, label = name, params = PARAMS[function_code],
        result = RESULT_NAMES[function_code] }
    if command then
        local codes, count = {}, 0
        for char in command:gmatch("[\0-\127\194-\244][\128-\191]*") do
            count = count + 1
            if count > LONGEST_NAME then break end
            codes[count] = char
        end
        kind.command = count > LONGEST_NAME and table.concat(codes) .. "…" or command
        kind.label = name .. " " .. printable(kind.command)
    end
    of_function[key], kind_count = kind, kind_count + 1
    return kind
end

-- Conversations: which end is the controller, and the latest requests by serial

local ports = {}
local flows, flow_count = {}, 0

local function new_conversation(pinfo, source, target)
    local conversation = { latest = {}, earlier = {}, count = 0, queues = {}, is_tcp = pinfo.port_type == 2 }
    local to_port, from_port = ports[pinfo.dst_port], ports[pinfo.src_port]
    conversation.client = from_port and not to_port and target or source
    conversation.is_guess = not to_port == not from_port
    return conversation
end

local function flow_of(pinfo)
    local source, target = tostring(pinfo.src) .. " " .. pinfo.src_port, tostring(pinfo.dst) .. " " .. pinfo.dst_port
    local key = source .. " " .. target .. " " .. pinfo.port_type
    local flow = flows[key]
    if flow then return flow end
    if flow_count >= MAX_FLOWS then flows, flow_count = {}, 0 end
    local conversation = new_conversation(pinfo, source, target)
    flow = { source = source, target = target, conversation = conversation }
    flows[target .. " " .. source .. " " .. pinfo.port_type] =
        { source = target, target = source, conversation = conversation }
    flows[key], flow_count = flow, flow_count + 2
    return flow
end

local function arguments_fit(frame)
    local params = PARAMS[frame.code]
    if not params or #frame.arguments ~= #params or frame.code == 1 and #params == 0 then return false end
    for index, node in ipairs(frame.arguments) do
        local types = SENT_TYPES[params[index][2]]
        if types and not types[node.vt] then return false end
    end
    return true
end

-- Let the content decide which end is the controller, where the ports do not.
local function check_direction(flow, frame)
    local conversation = flow.conversation
    if #frame.problems > 0 then return end
    if frame.code == 0 or frame.code == S_EXECUTING or frame.code >= 0x80000000 then
        conversation.client, conversation.is_guess = flow.target, false
    elseif arguments_fit(frame) then
        conversation.client, conversation.is_guess = flow.source, false
    end
end

-- What is known of each frame, by its key. Plain values take a tenth of the memory of a table per frame.
local is_request_by_key, kind_by_key, peer_by_key, request_time_by_key, first_by_key

-- For each frame that Wireshark passes again in a later packet: its key there, and its first key
local first_key_of

-- Keys of the bytes of a stream that continue garbage
local is_lost_by_key

local function forget_frames()
    flows, flow_count = {}, 0
    first_key_of, is_lost_by_key = {}, {}
    is_request_by_key, kind_by_key, peer_by_key, request_time_by_key, first_by_key = {}, {}, {}, {}, {}
end

local function remember_request(conversation, attempt)
    local serial = attempt.serial
    if not conversation.latest[serial] then conversation.count = conversation.count + 1 end
    conversation.latest[serial] = attempt
    if conversation.count >= MAX_SERIALS then
        conversation.earlier, conversation.latest, conversation.count = conversation.latest, {}, 0
    end
end

local function latest_attempt(conversation, serial)
    return conversation.latest[serial] or conversation.earlier[serial]
end

local function has_same_content(attempt, frame)
    return #attempt.raw == #frame.raw and sub(attempt.raw, 10) == sub(frame.raw, 10)
end

local function queue_reused_serial(conversation, prior)
    local queue = conversation.queues[prior.serial] or {}
    queue[#queue + 1] = prior
    if #queue > MAX_REUSED then table.remove(queue, 1) end
    conversation.queues[prior.serial] = queue
end

local function add_request(conversation, frame, pinfo, key)
    local serial, reserved, time = frame.serial, frame.reserved, pinfo.rel_ts
    local prior, first = latest_attempt(conversation, serial), nil
    local attempt = { key = key, number = pinfo.number, time = time, serial = serial, raw = frame.raw,
        kind = call_kind(frame.code, frame.command) }
    is_request_by_key[key], kind_by_key[key], request_time_by_key[key] = true, attempt.kind, time
    if conversation.is_tcp then
        if prior and not prior.is_answered then queue_reused_serial(conversation, prior) end
    elseif prior and prior.raw == frame.raw and time - prior.time <= COPIES_WITHIN then
        first_by_key[key] = first_by_key[prior.key]
        conversation.latest[serial] = prior -- a copy, not an attempt: replies and retries belong to the original
        return
    elseif reserved ~= 0 and reserved ~= serial then
        local origin = latest_attempt(conversation, reserved)
        if origin and has_same_content(origin, frame) and time - origin.time <= RETRY_WITHIN then
            first = first_by_key[origin.key] or { number = origin.number, serial = origin.serial }
        end
    end
    first_by_key[key] = first
    remember_request(conversation, attempt)
end

-- Link a reply to the attempt that it answers. The latest request with the serial names the function, as in
-- `bcapscope decode`; over TCP, where replies arrive in order, the oldest one that waits is answered.
local function add_reply(conversation, frame, pinfo, key)
    local latest = latest_attempt(conversation, frame.serial)
    is_request_by_key[key] = false
    if not latest then return end
    local answered, queue, is_notice = latest, conversation.queues[frame.serial], frame.code == S_EXECUTING
    if queue and queue[1] then
        answered = queue[1]
        if not is_notice then table.remove(queue, 1) end
    end
    kind_by_key[key], peer_by_key[key], request_time_by_key[key] = latest.kind, answered.number, answered.time
    if not answered.is_answered and not (is_notice and peer_by_key[answered.key]) then
        peer_by_key[answered.key] = pinfo.number
    end
    answered.is_answered = answered.is_answered or not is_notice
end

-- Return the links of a frame; the next call overwrites the table. A frame is linked when Wireshark reads it
-- first, in the order of the capture.
local links = {}
local function links_of(pinfo, frame, key)
    key = first_key_of[key] or key
    if is_request_by_key[key] == nil then
        local flow = flow_of(pinfo)
        local conversation = flow.conversation
        if conversation.is_guess then check_direction(flow, decode_frame(frame.raw)) end
        local add = conversation.client == flow.source and add_request or add_reply
        add(conversation, frame, pinfo, key)
    end
    links.is_request, links.kind, links.peer = is_request_by_key[key], kind_by_key[key], peer_by_key[key]
    links.request_time, links.first = request_time_by_key[key], first_by_key[key]
    return links
end

-- The tree

local function add_string(tree, tvb, offset, raw, place)
    tree:add_le(string_length_field, tvb(offset + place.at, 4))
    tree:add(text_field, tvb(offset + place.at + 4, place.size), string_text(raw, place))
end

local function add_numbers(tree, tvb, offset, base_type, numbers)
    local width, number_field = WIDTHS[base_type], number_fields[base_type]
    for index = 0, numbers.count - 1 do
        local range = tvb(offset + numbers.at + index * width, width)
        local item
        if base_type == BOOL then
            item = tree:add(number_field, range, range:le_uint() ~= 0)
        else
            item = tree:add_le(number_field, range)
        end
        if base_type == ERROR then
            item:append_text(" (" .. describe_result(range:le_uint()) .. ")")
        elseif base_type == CY then
            item:append_text((" (%.4f)"):format(range:le_int64():tonumber() / 10000))
        end
    end
end

local function add_bytes(tree, tvb, offset, bytes_at, place)
    if place.size > 0 then tree:add(bytes_at, tvb(offset + place.at, place.size)) end
end

local function add_value(tree, tvb, offset, raw, node)
    tree:add_le(type_field, tvb(offset + node.at, 2))
    tree:add_le(count_field, tvb(offset + node.at + 2, 4))
    if node.raw then
        add_bytes(tree, tvb, offset, raw_field, node.raw)
    elseif node.numbers then
        add_numbers(tree, tvb, offset, node.base, node.numbers)
    elseif node.bytes then
        add_bytes(tree, tvb, offset, bytes_field, node.bytes)
    elseif node.text then
        add_string(tree, tvb, offset, raw, node.text)
    elseif node.strings then
        for _, place in ipairs(node.strings) do add_string(tree, tvb, offset, raw, place) end
    elseif node.variants then
        for index, element in ipairs(node.variants) do
            local item = tree:add(element_field, tvb(offset + element.at, element.stop - element.at))
            item:set_text(("Element %d: %s"):format(index, type_name(element.vt)))
            add_value(item, tvb, offset, raw, element)
        end
    end
end

local function argument_name(kind, is_request, index)
    local params = kind and kind.params
    if is_request then return params and params[index] and params[index][1] or "arg" .. index end
    return index > 1 and "arg" .. index or kind and kind.result or "pVal"
end

local MAX_LABEL_NUMBERS = 12
local NUMBER_TEXTS = { -- by type: VT_I2, VT_I4, VT_R4, VT_R8
    [2] = function(range) return ("%d"):format(range:le_int()) end,
    [3] = function(range) return ("%d"):format(range:le_int()) end,
    [4] = function(range) return ("%.7g"):format(range:le_float()) end,
    [5] = function(range) return ("%.12g"):format(range:le_float()) end,
}

local function numbers_text(tvb, offset, node)
    local text_of, width, texts = NUMBER_TEXTS[node.base], WIDTHS[node.base], {}
    if not text_of or not node.numbers or node.numbers.count == 0 then return "" end
    for index = 1, math.min(node.numbers.count, MAX_LABEL_NUMBERS) do
        texts[index] = text_of(tvb(offset + node.numbers.at + (index - 1) * width, width))
    end
    if node.numbers.count > MAX_LABEL_NUMBERS then texts[#texts + 1] = "…" end
    return " " .. table.concat(texts, ", ")
end

local function value_text(tvb, offset, raw, node)
    if node.text then return ' "' .. printable(string_text(raw, node.text)) .. '"' end
    local count = node.is_array and (" [%d]"):format(node.count) or ""
    return count .. numbers_text(tvb, offset, node)
end

local function add_argument(tree, tvb, offset, frame, node, name)
    local item = tree:add(argument_field, tvb(offset + node.start, node.stop - node.start))
    item:set_text(("%s: %s%s"):format(name, type_name(node.vt), value_text(tvb, offset, frame.body, node)))
    item:add(name_field, tvb(offset + node.start, node.stop - node.start), name):set_generated()
    item:add_le(argument_length_field, tvb(offset + node.start, 4))
    add_value(item, tvb, offset, frame.body, node)
    return item
end

local function add_slave_mode(tree, tvb, offset, links, node)
    local command = links.kind.command
    if not (links.is_request and node and command and command:lower() == "slvchangemode") then return end
    local numbers = node.numbers
    if numbers and numbers.count > 0 and (node.base == 2 or node.base == 3) then
        local range = tvb(offset + numbers.at, WIDTHS[node.base])
        local mode = range:le_int()
        if mode >= 0 then tree:add(slave_mode_field, range, mode):set_generated() end
    end
end

local function add_problems(tree, tvb, offset, size, problems)
    for _, problem in ipairs(problems) do
        local at = math.min(problem.offset, size)
        local item = tree:add(problem_field, tvb(offset + at, math.min(1, size - at)), problem.reason)
        item:add(problem_code_field, problem.code):set_generated()
        item:add(problem_offset_field, problem.offset):set_generated()
        item:add_proto_expert_info(damaged, problem.reason)
    end
end

local function add_links(tree, pinfo, links)
    if links.is_request then
        if links.first then tree:add(retry_of_field, links.first.number):set_generated() end
        if links.peer then tree:add(response_in_field, links.peer):set_generated() end
    elseif links.peer then
        tree:add(response_to_field, links.peer):set_generated()
        local seconds = pinfo.rel_ts - links.request_time
        local whole = floor(seconds)
        tree:add(rtt_field, NSTime.new(whole, floor((seconds - whole) * 1e9 + 0.5))):set_generated()
    end
end

local function add_call(tree, tvb, offset, frame, links)
    local kind, code_range = links.kind, tvb(offset + 9, 4)
    if links.is_request then
        tree:add_le(function_id_field, code_range)
        tree:add(function_field, code_range, kind.name):set_generated()
    else
        local name, text = describe_result(frame.code)
        local shown = sub(name, 1, 2) == "0x" and "" or " " .. name
        tree:add_le(hresult_field, code_range):append_text(shown .. ": " .. text)
        tree:add(hresult_name_field, code_range, name):set_generated()
        tree:add(hresult_text_field, code_range, text):set_generated()
        if kind then
            tree:add(function_id_field, kind.id):set_generated()
            tree:add(function_field, kind.name):set_generated()
        end
    end
    if kind and kind.command then
        local node = links.is_request and frame.arguments[2]
        local range = node and tvb(offset + node.text.at + 4, node.text.size)
        local item = range and tree:add(command_field, range, kind.command) or tree:add(command_field, kind.command)
        item:set_generated()
        add_slave_mode(tree, tvb, offset, links, frame.arguments[3])
    end
end

local function add_frame(tree, pinfo, tvb, offset, frame, links, summary)
    local size = #frame.raw
    local item = tree:add(bcap, tvb(offset, size), "DENSO b-CAP, " .. summary)
    item:add(kind_field, tvb(offset, size), links.is_request and "request" or "response"):set_generated()
    item:add_le(length_field, tvb(offset + 1, 4))
    item:add_le(serial_field, tvb(offset + 5, 2))
    item:add_le(reserved_field, tvb(offset + 7, 2))
    local body_tvb, body_offset = tvb, offset
    if frame.body ~= frame.raw then
        body_tvb, body_offset = ByteArray.new(frame.body, true):tvb("Unpacked b-CAP frame"), 0
    end
    add_call(item, body_tvb, body_offset, frame, links)
    item:add_le(argc_field, body_tvb(body_offset + 13, 2))
    for index, node in ipairs(frame.arguments) do
        add_argument(item, body_tvb, body_offset, frame, node, argument_name(links.kind, links.is_request, index))
    end
    if frame.framing ~= "plain" then item:add(framing_field, frame.framing):set_generated() end
    add_links(item, pinfo, links)
    add_problems(item, body_tvb, body_offset, #frame.body, frame.problems)
end

-- The packet list

local function frame_summary(frame, links)
    local label, text = links.kind and links.kind.label
    if not links.is_request then
        local name, meaning = describe_result(frame.code)
        text = "Reply " .. frame.serial .. " " .. name
        if label then text = text .. " to " .. label end
        if is_failure(frame.code) then text = text .. " (" .. meaning .. ")" end
    elseif links.first then
        text = "Retry " .. frame.serial .. " of " .. links.first.serial .. " " .. label
    else
        text = "Request " .. frame.serial .. " " .. label
    end
    if #frame.problems > 0 then text = text .. " !! " .. frame.problems[1].reason end
    return text
end

local function not_a_frame(raw, is_in_stream)
    local code, reason = "soh", nil
    if is_in_stream and byte(raw, 1) ~= SOH then
        reason = TEXTS["problem.soh.outside"]
    elseif #raw == 0 then
        reason = TEXTS["problem.soh.no-bytes"]
    elseif byte(raw, 1) ~= SOH then
        reason = message("problem.soh", { byte = ("%02X"):format(byte(raw, 1)) })
    elseif is_in_stream then
        code, reason = "short", message("problem.short.cut", { size = #raw })
    else
        code, reason = "short", message("problem.short", { bytes = counted(#raw, "byte"), least = SMALLEST_FRAME })
    end
    return { offset = 0, code = code, reason = reason }
end

-- Return whether anything shows or filters the tree. Without tree, a frame takes a fifth of the time.
local own_dissector
local function is_tree_wanted(tree)
    own_dissector = own_dissector or Dissector.get("bcap")
    return tree.visible or tree:referenced(own_dissector)
end

-- Dissect a frame, or bytes that are not a frame; return its text for the packet list.
local function dissect_piece(tvb, offset, raw, piece, pinfo, tree, key, notes)
    if not piece.is_frame then
        local problems = { not_a_frame(raw, piece.is_in_stream), notes[1] }
        local item = tree:add(bcap, tvb(offset, #raw), "DENSO b-CAP, not a frame")
        item:add(kind_field, tvb(offset, #raw), "malformed"):set_generated()
        add_problems(item, tvb, offset, #raw, problems)
        return "Not a frame !! " .. problems[1].reason
    end
    local is_wanted = is_tree_wanted(tree)
    local frame = not is_wanted and #notes == 0 and brief_frame(raw) or decode_frame(raw)
    for _, note in ipairs(notes) do frame.problems[#frame.problems + 1] = note end
    local links = links_of(pinfo, frame, key)
    local summary = frame_summary(frame, links)
    if is_wanted or #frame.problems > 0 then add_frame(tree, pinfo, tvb, offset, frame, links, summary) end
    return summary
end

local function dissect_pieces(tvb, raw, pieces, pinfo, tree, base_key, notes_of)
    local texts = {}
    for index, piece in ipairs(pieces) do
        local part = #pieces == 1 and piece.size == #raw and raw or sub(raw, piece.at + 1, piece.at + piece.size)
        texts[index] = dissect_piece(tvb, piece.at, part, piece, pinfo, tree,
            base_key + piece.at * OFFSET_UNIT, notes_of(index, piece))
    end
    return #texts == 1 and texts[1] or table.concat(texts, ", ")
end

local NO_NOTES = {}
local function no_notes() return NO_NOTES end

local function dissect_datagram(tvb, pinfo, tree)
    local size, reported = tvb:len(), tvb:reported_len()
    local raw = tvb:raw(0, size)
    pinfo.cols.protocol = "b-CAP"
    local frame = reported == size and not is_tree_wanted(tree) and brief_frame(raw)
    if frame then -- nearly all datagrams, in the packet list
        pinfo.cols.info = frame_summary(frame, links_of(pinfo, frame, pinfo.number))
        return size
    end
    local pieces = split_datagram(raw)
    local notes_of = no_notes
    if reported > size then
        notes_of = function(index, piece)
            if index < #pieces then return NO_NOTES end
            return { { offset = piece.size, code = "cut",
                reason = message("problem.cut.by-capture", { kept = size, size = reported }) } }
        end
    elseif #pieces > 1 then
        notes_of = function(index, piece)
            if index > 1 then return NO_NOTES end
            return { { offset = piece.size, code = "length",
                reason = message("problem.length.datagram", { claimed = piece.size, present = size }) } }
        end
    end
    pinfo.cols.info = dissect_pieces(tvb, raw, pieces, pinfo, tree, pinfo.number, notes_of)
    return size
end

-- Return the pieces that this packet shows, and the offset of the first byte that needs more bytes. While Wireshark
-- reads a capture, it may pass the same bytes in several packets. Then only the first of these packets shows the
-- pieces. When the user opens a packet later, Wireshark passes the bytes only in the last of these packets.
local function stream_pieces(raw, pinfo, base_key)
    if pinfo.visited or pinfo.can_desegment == 0 then return split_stream(raw, is_lost_by_key[base_key]) end
    local flow = flow_of(pinfo)
    local stream = flow.stream or new_stream()
    flow.stream = stream
    local pieces, rest, done, is_lost = continue_stream(stream, raw)
    if is_lost then is_lost_by_key[base_key] = true end
    if done > 0 then
        local new_pieces = {}
        for _, piece in ipairs(pieces) do
            if piece.at >= done then
                new_pieces[#new_pieces + 1] = piece
            else
                local earlier = flow.base_key + piece.at * OFFSET_UNIT
                first_key_of[base_key + piece.at * OFFSET_UNIT] = first_key_of[earlier] or earlier
            end
        end
        pieces = new_pieces
    end
    flow.base_key = base_key
    return pieces, rest
end

-- dissect_tcp_pdus would trust every length field; the splitter finds the next frame after damaged bytes.
local function dissect_stream(tvb, pinfo, tree)
    local raw = tvb:raw(0, tvb:len())
    local base_key = pinfo.number + tvb:offset() * OFFSET_UNIT
    local pieces, rest = stream_pieces(raw, pinfo, base_key)
    if rest < #raw and pinfo.can_desegment > 0 then
        pinfo.desegment_offset = rest
        pinfo.desegment_len = DESEGMENT_ONE_MORE_SEGMENT
    elseif rest < #raw then
        pieces[#pieces + 1] = stream_piece(raw, rest, #raw - rest)
    end
    if #pieces == 0 then return tvb:len() end
    pinfo.cols.protocol = "b-CAP"
    pinfo.cols.info = dissect_pieces(tvb, raw, pieces, pinfo, tree, base_key, no_notes)
    return tvb:len()
end

function bcap.dissector(tvb, pinfo, tree)
    if pinfo.port_type == 2 then return dissect_stream(tvb, pinfo, tree) end
    return dissect_datagram(tvb, pinfo, tree)
end

-- Ports, and the recognition of b-CAP on other ports

local function is_whole_frames(raw)
    if #raw < SMALLEST_FRAME then return false end
    for _, piece in ipairs(split_datagram(raw)) do
        if not piece.is_frame or piece.size < SMALLEST_FRAME or u32(raw, piece.at + 1) ~= piece.size
            or byte(raw, piece.at + piece.size) ~= EOT then
            return false
        end
    end
    return true
end

local function recognise(tvb, pinfo, tree)
    if tvb:len() < SMALLEST_FRAME or tvb(0, 1):uint() ~= SOH then return false end
    local raw = tvb:raw(0, tvb:len())
    if pinfo.port_type == 2 then
        local trust, length = assess_header(raw, 0, false)
        if trust ~= "confirmed" or length > #raw or byte(raw, length) ~= EOT then return false end
    elseif not is_whole_frames(raw) then
        return false
    end
    pinfo.conversation = bcap
    bcap.dissector(tvb, pinfo, tree)
    return true
end

local registered
local function register_ports()
    local wanted = tostring(bcap.prefs.ports)
    if wanted == registered then return end
    for _, name in ipairs({ "udp.port", "tcp.port" }) do
        local table_of_ports = DissectorTable.get(name)
        if registered and registered ~= "" then table_of_ports:remove(registered, bcap) end
        if wanted ~= "" then table_of_ports:add(wanted, bcap) end
    end
    registered, ports = wanted, {}
    for first, last in wanted:gmatch("(%d+)%-?(%d*)") do
        for port = tonumber(first), tonumber(last ~= "" and last or first) do ports[port] = true end
    end
end

function bcap.init()
    forget_frames()
    register_ports()
end

function bcap.prefs_changed() register_ports() end

forget_frames()
register_ports()
bcap:register_heuristic("udp", recognise)
bcap:register_heuristic("tcp", recognise)
