-- Converts a document to plain paragraphs. Each table row becomes a paragraph. After a form feed,
-- a line names each kind of content that is left out.

local KINDS = {
  picture = "pictures", formula = "formulas", ["raw passage"] = "raw passages",
  ["page number of print"] = "page numbers of print",
}
local left_out, sources = {}, pandoc.List()

local function leave_out(kind, replacement, source)
  left_out[kind] = (left_out[kind] or 0) + 1
  if source then sources:insert((source:gsub("%s+", " "))) end
  return replacement or {}
end

local function plain(blocks)
  local text = pandoc.write(pandoc.Pandoc(blocks), "plain"):gsub("%s+", " ")
  return text:match("^ ?(.-) ?$")
end

local function unwrap(element)
  local marks = element.classes and element.classes:clone() or pandoc.List()
  for _, value in pairs(element.attributes or {}) do marks:insert(value) end
  if marks:includes("pagebreak") or marks:includes("doc-pagebreak") then
    return leave_out("page number of print")
  end
  -- Drop content that is hidden from screen readers: it repeats other content, as in KaTeX formulas.
  local hidden = (element.attributes or {})["aria-hidden"] == "true"
  return (hidden or marks:includes("footnote-back")) and {} or element.content
end

-- Converts raw HTML scripts in Markdown, such as <sup>6</sup>, to elements.
local function join_raw_scripts(inlines)
  for first = #inlines, 1, -1 do
    local tag = inlines[first].t == "RawInline" and inlines[first].text:match("^<(su[pb])>$")
    local last = tag and first + 1 or #inlines + 1
    while inlines[last] and inlines[last].text ~= "</" .. tag .. ">" do last = last + 1 end
    if inlines[last] then
      local content = {}
      for k = first + 1, last do content[k - first] = inlines:remove(first + 1) end
      content[#content] = nil
      inlines[first] = (tag == "sup" and pandoc.Superscript or pandoc.Subscript)(content)
    end
  end
  return inlines
end

-- Writes 10^6, or 10^(a+b) if the end of the script would be unclear; leaves 21st unchanged.
local function mark_scripts(inlines)
  for k, element in ipairs(inlines) do
    local sign = ({ Superscript = "^", Subscript = "_" })[element.t]
    if sign then
      local text = pandoc.utils.stringify(element.content)
      local before = k > 1 and inlines[k - 1].text or ""
      local after = inlines[k + 1] and inlines[k + 1].text or ""
      if not text:match("^[+-]?%w+$") or after:match("^%d") then
        text = sign .. "(" .. text .. ")"
      elseif sign == "_" or not text:match("^%a%a+$") or not before:match("%d$") then
        text = sign .. text
      end
      inlines[k] = pandoc.Str(text)
    end
  end
  return inlines
end

local function row(cells)
  local texts = pandoc.List(cells):map(function(cell)
    local text = plain(cell)
    return text == "" and "-" or text
  end)
  local line = table.concat(texts, "; ")
  return pandoc.Plain(line:match("[^-; ]") and { pandoc.Str(line) } or {})
end

-- Returns title and authors if the text itself lacks the title, as in DOCX and Markdown.
local function front(doc)
  local lines, seen = pandoc.List(), { [""] = true }
  for k = 1, math.min(#doc.blocks, 12) do seen[plain({ doc.blocks[k] }):lower()] = true end
  for _, key in ipairs({ "title", "subtitle", "author", "date" }) do
    local value = doc.meta[key] or ""
    if pandoc.utils.type(value) ~= "List" then value = { value } end
    local line = table.concat(pandoc.List(value):map(pandoc.utils.stringify), ", ")
    if key == "title" and seen[line:lower()] then return lines end
    if line ~= "" then lines:insert(pandoc.Para({ pandoc.Str(line) })) end
  end
  return lines
end

return {
  { Inlines = join_raw_scripts },
  {
    RawBlock = function(raw)
      return raw.format == "html" and pandoc.read(raw.text, "html").blocks
        or leave_out("raw passage")
    end,
    RawInline = function(raw)
      if raw.text:match("^<br") then return pandoc.LineBreak() end
      return raw.format == "html" and pandoc.utils.blocks_to_inlines(pandoc.read(raw.text, "html").blocks)
        or leave_out("raw passage")
    end,
  },
  {
    Emph = unwrap, Strong = unwrap, Underline = unwrap, SmallCaps = unwrap,
    Span = unwrap, Div = unwrap, Link = unwrap,
    Strikeout = function(struck)
      return { pandoc.Str("(struck out: "), pandoc.Span(struck.content), pandoc.Str(")") }
    end,
    Math = function(math)
      local text = plain({ pandoc.Plain({ math }) })
      if not text:match("[\\${}]") then
        return pandoc.Str((text:gsub("[%^_]%b()", function(script) return (script:gsub(" ", ""):gsub("\u{2005}", "")) end)))
      end
      return leave_out("formula", pandoc.Str("(formula)"), math.text)
    end,
    Image = function(image)
      if pandoc.utils.stringify(image.caption):match("\\%a") then
        return leave_out("formula", pandoc.Str("(formula)"), pandoc.utils.stringify(image.caption))
      end
      return leave_out("picture", image.caption)
    end,
    Note = function(note) return pandoc.Str(" (" .. plain(note.content) .. ")") end,
    Inlines = mark_scripts,
    HorizontalRule = function() return {} end,
    Table = function(whole)
      local simple = pandoc.utils.to_simple_table(whole)
      local rows = pandoc.List(simple.rows):map(row)
      return pandoc.List({ pandoc.Plain(simple.caption), row(simple.headers) }) .. rows
    end,
  },
  {
    Pandoc = function(doc)
      local notes = pandoc.List()
      for kind, several in pairs(KINDS) do
        local number = left_out[kind] or 0
        local which = kind == "formula" and ": " .. table.concat(sources, ", ") or ""
        if number == 1 then notes:insert("1 " .. kind .. " is left out" .. which) end
        if number > 1 then notes:insert(number .. " " .. several .. " are left out" .. which) end
      end
      notes:sort()
      local text = pandoc.RawBlock("plain", "\f" .. table.concat(notes, "\n"))
      return pandoc.Pandoc(front(doc) .. doc.blocks .. { text })
    end,
  },
}
