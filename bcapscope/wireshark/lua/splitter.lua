-- Find the frames in a datagram or in a part of a TCP stream, with the rules of `bcapscope decode`.
--
-- Each function returns pieces: offset, size, and whether the piece is a frame.
--
-- Exports: assess_header, stream_piece, split_datagram, split_stream, new_stream, continue_stream

function split_datagram(raw)
    local pieces, pos, size = {}, 0, #raw
    while true do
        local length = size - pos >= 5 and u32(raw, pos + 1) or 0
        local goes_on = length >= SMALLEST_FRAME and length < size - pos and byte(raw, pos + 1) == SOH
            and byte(raw, pos + length) == EOT
        local stop = goes_on and pos + length or size
        pieces[#pieces + 1] = { at = pos, size = stop - pos,
            is_frame = stop - pos >= HEADER_SIZE and byte(raw, pos + 1) == SOH }
        if not goes_on then return pieces end
        pos = stop
    end
end

-- Follow the length fields of the arguments; return the offset after the last one, 0 if a length is impossible,
-- nil if more bytes are needed.
local function walk_arguments(raw, pos, stop, argc)
    local at = pos + HEADER_SIZE
    for _ = 1, argc do
        if at + SMALLEST_ARGUMENT > stop then return 0 end
        if at + 4 > #raw then return nil end
        local claimed = u32(raw, at)
        if claimed < SMALLEST_ARGUMENT - 4 then return 0 end
        at = at + 4 + claimed
    end
    return at
end

-- Return how certain it is that a frame begins at `pos`, and the length of this frame.
function assess_header(raw, pos, is_synchronized)
    if #raw - pos < HEADER_SIZE then return "incomplete", 0 end
    local length, argc = u32(raw, pos + 1), u16(raw, pos + 13)
    local largest = is_synchronized and LARGEST_FRAME or LARGEST_UNCONFIRMED
    if length < SMALLEST_FRAME or length > largest then return "none", 0 end
    local is_packed = has_compressed_header(raw, pos)
    if argc > MAX_RESYNC_ARGUMENTS and not is_synchronized and not is_packed then return "none", 0 end
    local stop = pos + length
    local last
    if is_packed then last = stop - 1 else last = walk_arguments(raw, pos, stop, argc) end
    if not last then return "incomplete", length end
    if stop - last >= 1 and stop - last <= 3 then return "confirmed", length end
    return length <= LARGEST_UNCONFIRMED and "unconfirmed" or "none", length
end

-- Return whether a frame of `length` bytes begins at `pos`; nil if more bytes are needed.
local function ends_at(raw, pos, length, trust)
    local stop = pos + length
    if #raw < stop then return nil end
    if byte(raw, stop) == EOT or trust ~= "confirmed" then return byte(raw, stop) == EOT end
    if #raw == stop then return nil end
    return byte(raw, stop + 1) == SOH
end

-- Return the offset of the next whole frame from `pos` on, and true. If the garbage before it has the largest
-- size, return the end of this garbage, and false. Return nil if more bytes are needed.
local function next_frame(raw, pos)
    local limit, at = pos + LARGEST_GARBAGE, pos
    while true do
        at = raw:find("\1", at + 1, true)
        if not at or at > limit then return #raw >= limit and limit or nil, false end
        at = at - 1
        local trust, length = assess_header(raw, at, false)
        if trust == "incomplete" then return nil end
        if trust == "confirmed" then
            if #raw < at + length then return nil end
            if byte(raw, at + length) == EOT then return at, true end
        end
        at = at + 1
    end
end

function stream_piece(raw, at, size)
    return { at = at, size = size, is_in_stream = true, is_frame = byte(raw, at + 1) == SOH and size >= HEADER_SIZE }
end

-- Return the size of the piece at `pos`, and whether a frame begins after it; nil if more bytes are needed.
local function next_piece(raw, pos, is_synchronized)
    if is_synchronized and byte(raw, pos + 1) == SOH then
        local trust, length = assess_header(raw, pos, true)
        if trust == "incomplete" then return nil end
        if trust ~= "none" then
            local ends = ends_at(raw, pos, length, trust)
            if ends == nil then return nil end
            if ends then return length, true end
        end
    end
    local stop, is_frame = next_frame(raw, pos)
    if stop == pos then return next_piece(raw, pos, true) end
    return stop and stop - pos, is_frame
end

-- Return the pieces that are complete, the offset of the first byte that needs more bytes, and whether a frame
-- begins there. `is_lost` is true if the bytes continue garbage. After garbage, a frame needs more evidence.
function split_stream(raw, is_lost)
    local pieces, pos, is_synchronized = {}, 0, not is_lost
    while pos < #raw do
        local size, is_frame_next = next_piece(raw, pos, is_synchronized)
        if not size then break end
        pieces[#pieces + 1] = stream_piece(raw, pos, size)
        pos, is_synchronized = pos + size, is_frame_next
    end
    return pieces, pos, is_synchronized
end

-- Wireshark passes the bytes after the last piece again, followed by the next segment. If the last piece ends
-- before the latest segment, Wireshark passes the bytes of all pieces again too. So a stream remembers the bytes
-- that Wireshark will pass again (`pending`). `done` is the size of the pieces at the start of `pending` that
-- were already returned.
function new_stream() return { pending = "", done = 0, is_lost = false } end

-- Do the same as `split_stream` for the next bytes that Wireshark passes of a stream. Also return the size of the
-- pieces at the start of `raw` that an earlier call returned, and whether `raw` begins in garbage.
function continue_stream(stream, raw)
    local passed, done, is_lost = #stream.pending, stream.done, stream.is_lost
    if passed == 0 or #raw <= passed or sub(raw, 1, passed) ~= stream.pending then
        done, is_lost = 0, is_lost and passed == 0
        passed = 0
    end
    local pieces, rest, is_synchronized = split_stream(raw, is_lost)
    if rest > 0 and rest < #raw and rest <= passed then
        stream.pending, stream.done, stream.is_lost = raw, rest, is_lost
    else
        stream.pending, stream.done, stream.is_lost = sub(raw, rest + 1), 0, not is_synchronized
    end
    return pieces, rest, done, is_lost
end
