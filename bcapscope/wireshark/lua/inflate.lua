-- Unpack zlib data (RFC 1950, RFC 1951), for compressed frames of version 1.
--
-- Wireshark's own functions differ between versions, and do not show whether the data ended early. This part
-- uses no bit operators, which Lua 5.2 lacks.
--
-- Exports: inflate

local LENGTH_BASES = { 3, 4, 5, 6, 7, 8, 9, 10, 11, 13, 15, 17, 19, 23, 27, 31, 35, 43, 51, 59, 67, 83, 99, 115,
    131, 163, 195, 227, 258 }
local LENGTH_BITS = { 0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 0 }
local DISTANCE_BASES = { 1, 2, 3, 4, 5, 7, 9, 13, 17, 25, 33, 49, 65, 97, 129, 193, 257, 385, 513, 769, 1025, 1537,
    2049, 3073, 4097, 6145, 8193, 12289, 16385, 24577 }
local DISTANCE_BITS = { 0, 0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4, 5, 5, 6, 6, 7, 7, 8, 8, 9, 9, 10, 10, 11, 11, 12, 12,
    13, 13 }
local CODE_ORDER = { 16, 17, 18, 0, 8, 7, 9, 6, 10, 5, 11, 4, 12, 3, 13, 2, 14, 1, 15 }

-- Errors that end the unpacking: the data ends early, or the output limit is reached, or the data is not zlib.
local EARLY, FULL, INVALID = {}, {}, {}

local function read_bits(z, count)
    while z.held < count do
        local next_byte = string.byte(z.data, z.pos)
        if not next_byte then error(EARLY) end
        z.pos = z.pos + 1
        z.bits = z.bits + next_byte * 2 ^ z.held
        z.held = z.held + 8
    end
    local size = 2 ^ count
    local value = z.bits % size
    z.bits = (z.bits - value) / size
    z.held = z.held - count
    return math.floor(value)
end

local function put(z, value)
    if #z.out >= z.limit then error(FULL) end
    z.out[#z.out + 1] = value
end

-- Return a canonical Huffman code from the code lengths of its symbols, from 0.
local function huffman_code(lengths, first, count, may_be_incomplete)
    local counts, symbols, offsets = {}, {}, { [1] = 0 }
    for length = 0, 15 do counts[length] = 0 end
    for symbol = 0, count - 1 do
        local length = lengths[first + symbol]
        counts[length] = counts[length] + 1
    end
    if counts[0] < count then
        local left, longest = 1, 0
        for length = 1, 15 do
            left = left * 2 - counts[length]
            if left < 0 then error(INVALID) end
            if counts[length] > 0 then longest = length end
        end
        if left > 0 and not (may_be_incomplete and longest == 1) then error(INVALID) end
    end
    for length = 1, 14 do offsets[length + 1] = offsets[length] + counts[length] end
    for symbol = 0, count - 1 do
        local length = lengths[first + symbol]
        if length > 0 then
            symbols[offsets[length]] = symbol
            offsets[length] = offsets[length] + 1
        end
    end
    return { counts = counts, symbols = symbols }
end

local function read_symbol(z, code)
    local value, first, index = 0, 0, 0
    for length = 1, 15 do
        value = value + read_bits(z, 1)
        local count = code.counts[length]
        if value - count < first then return code.symbols[index + value - first] end
        index = index + count
        first = (first + count) * 2
        value = value * 2
    end
    error(INVALID)
end

local function read_block(z, literals, distances)
    while true do
        local symbol = read_symbol(z, literals)
        if symbol == 256 then return end
        if symbol < 256 then
            put(z, symbol)
        else
            symbol = symbol - 256
            if symbol > #LENGTH_BASES then error(INVALID) end
            local length = LENGTH_BASES[symbol] + read_bits(z, LENGTH_BITS[symbol])
            symbol = read_symbol(z, distances) + 1
            if symbol > #DISTANCE_BASES then error(INVALID) end
            local distance = DISTANCE_BASES[symbol] + read_bits(z, DISTANCE_BITS[symbol])
            if distance > #z.out then error(INVALID) end
            for _ = 1, length do put(z, z.out[#z.out - distance + 1]) end
        end
    end
end

local function read_stored_block(z)
    z.bits, z.held = 0, 0
    local size = read_bits(z, 16)
    if read_bits(z, 16) ~= 65535 - size then error(INVALID) end
    for _ = 1, size do put(z, read_bits(z, 8)) end
end

local function fixed_codes()
    local lengths = {}
    for symbol = 0, 287 do
        lengths[symbol] = symbol < 144 and 8 or symbol < 256 and 9 or symbol < 280 and 7 or 8
    end
    for symbol = 288, 319 do lengths[symbol] = 5 end
    return huffman_code(lengths, 0, 288), huffman_code(lengths, 288, 32)
end

local function dynamic_codes(z)
    local literals, distances, codes = read_bits(z, 5) + 257, read_bits(z, 5) + 1, read_bits(z, 4) + 4
    if literals > 286 or distances > 30 then error(INVALID) end
    local lengths = {}
    for index = 1, 19 do lengths[CODE_ORDER[index]] = index <= codes and read_bits(z, 3) or 0 end
    local code = huffman_code(lengths, 0, 19)
    local index = 0
    while index < literals + distances do
        local symbol, length, times = read_symbol(z, code), 0, 1
        if symbol == 16 then
            if index == 0 then error(INVALID) end
            length, times = lengths[index - 1], 3 + read_bits(z, 2)
        elseif symbol == 17 then
            times = 3 + read_bits(z, 3)
        elseif symbol == 18 then
            times = 11 + read_bits(z, 7)
        else
            length = symbol
        end
        if index + times > literals + distances then error(INVALID) end
        for _ = 1, times do
            lengths[index] = length
            index = index + 1
        end
    end
    if lengths[256] == 0 then error(INVALID) end
    return huffman_code(lengths, 0, literals, true), huffman_code(lengths, literals, distances, true)
end

local function adler32(values)
    local a, b = 1, 0
    for _, value in ipairs(values) do
        a = (a + value) % 65521
        b = (b + a) % 65521
    end
    return a, b
end

local function read_blocks(z)
    local final
    repeat
        final = read_bits(z, 1)
        local kind = read_bits(z, 2)
        if kind == 0 then
            read_stored_block(z)
        elseif kind == 1 then
            read_block(z, fixed_codes())
        elseif kind == 2 then
            read_block(z, dynamic_codes(z))
        else
            error(INVALID)
        end
    until final == 1
    z.bits, z.held = 0, 0
    local high, low = read_bits(z, 8) * 256 + read_bits(z, 8), read_bits(z, 8) * 256 + read_bits(z, 8)
    local a, b = adler32(z.out)
    if high ~= b or low ~= a then error(INVALID) end
end

-- Return the unpacked data, whether it is whole, and whether bytes follow it; nil if `data` is not zlib.
-- The unpacked data has at most `limit` bytes.
function inflate(data, limit)
    local z = { data = data, pos = 3, bits = 0, held = 0, out = {}, limit = limit }
    local header = string.byte(data, 1) * 256 + (string.byte(data, 2) or 0)
    if #data < 2 or header % 31 ~= 0 or math.floor(header / 32) % 2 == 1 then return nil end
    local is_whole, reason = pcall(read_blocks, z)
    if not is_whole and reason ~= EARLY and reason ~= FULL then return nil end
    local parts = {}
    for first = 1, #z.out, 4096 do
        parts[#parts + 1] = string.char(table.unpack(z.out, first, math.min(first + 4095, #z.out)))
    end
    return table.concat(parts), is_whole, is_whole and z.pos <= #data
end
