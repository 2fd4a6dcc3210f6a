-- Find the frames in a datagram or in a part of a TCP stream, with the rules of `bcapscope decode`.
--
-- Each function returns pieces: offset, size, and whether the piece is a frame.
--
-- Exports: assess_header, stream_piece, split_datagram, split_stream

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

-- Return the offset of the next whole frame after `pos`; nil if more bytes are needed to find it.
local function next_frame(raw, pos)
    local limit, at = pos + LARGEST_GARBAGE, pos
    while true do
        at = raw:find("\1", at + 1, true)
        if not at or at > limit then return #raw >= limit and limit or nil end
        at = at - 1
        local trust, length = assess_header(raw, at, false)
        if trust == "incomplete" then return nil end
        if trust == "confirmed" then
            if #raw < at + length then return nil end
            if byte(raw, at + length) == EOT then return at end
        end
        at = at + 1
    end
end

function stream_piece(raw, at, size)
    return { at = at, size = size, is_in_stream = true, is_frame = byte(raw, at + 1) == SOH and size >= HEADER_SIZE }
end

-- Return the pieces that are complete, and the offset of the first byte that needs more bytes.
function split_stream(raw)
    local pieces, pos = {}, 0
    while pos < #raw do
        local size
        if byte(raw, pos + 1) == SOH then
            local trust, length = assess_header(raw, pos, true)
            if trust == "incomplete" then return pieces, pos end
            if trust ~= "none" then
                local ends = ends_at(raw, pos, length, trust)
                if ends == nil then return pieces, pos end
                size = ends and length
            end
        end
        if not size then
            local stop = next_frame(raw, pos)
            if not stop then return pieces, pos end
            if stop == pos then return pieces, pos end
            size = stop - pos
        end
        pieces[#pieces + 1] = stream_piece(raw, pos, size)
        pos = pos + size
    end
    return pieces, pos
end
