"""The style sheet of a report: light, dark and on paper."""

from __future__ import annotations

_LIGHT = """\
  --ground: #ffffff; --panel: #f5f7f9; --ink: #1c2227; --soft: #56606a; --line: #d5dbe1; --grid: #e4e8ec;
  --link: #1d63a8; --error: #b3261e; --warning: #8a5a00; --note: #3f5f7d; --good: #1c6e45;"""
_DARK = """\
  --ground: #15191d; --panel: #1d2328; --ink: #e6eaee; --soft: #a3adb7; --line: #38424b; --grid: #2a3239;
  --link: #7fb5ea; --error: #ff8f85; --warning: #e5b455; --note: #9dc0e0; --good: #6fcf9c;"""

STYLE = (
    """\
:root { color-scheme: light;
"""
    + _LIGHT
    + """ }
@media (prefers-color-scheme: dark) { :root:not([data-theme=light]) { color-scheme: dark;
"""
    + _DARK
    + """ } }
:root[data-theme=dark] { color-scheme: dark;
"""
    + _DARK
    + """ }
* { box-sizing: border-box; }
body { margin: 0; background: var(--ground); color: var(--ink); line-height: 1.5;
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Noto Sans", "Noto Sans JP", sans-serif; }
header, nav, main, footer { max-width: 1120px; margin: 0 auto; padding: 0 24px; }
header { padding-top: 28px; display: flex; flex-wrap: wrap; gap: 8px 32px; align-items: flex-start; }
header > div { flex: 1 1 480px; }
h1 { font-size: 1.9rem; line-height: 1.2; margin: 0 0 4px; }
h2 { font-size: 1.4rem; margin: 44px 0 8px; padding-top: 12px; border-top: 1px solid var(--line); }
h3 { font-size: 1.1rem; margin: 28px 0 4px; }
p, dl, ol { margin: 0 0 12px; }
a { color: var(--link); }
.soft, figcaption, .source { color: var(--soft); font-size: 0.92rem; }
.names { overflow-wrap: anywhere; }
:focus-visible { outline: 3px solid var(--link); outline-offset: 2px; }
.skip { position: absolute; left: -100vw; }
.skip:focus { left: 8px; top: 8px; background: var(--ground); padding: 8px; z-index: 2; }
fieldset.theme { border: 1px solid var(--line); border-radius: 6px; padding: 2px 10px 6px; margin: 0; }
fieldset.theme legend { font-size: 0.8rem; color: var(--soft); padding: 0 4px; }
fieldset.theme label { margin-right: 10px; font-size: 0.9rem; cursor: pointer; }
nav { padding-top: 12px; font-size: 0.95rem; }
nav a { margin-right: 16px; display: inline-block; }
.verdict { font-size: 1.12rem; padding: 14px 18px; margin: 16px 0; overflow-wrap: anywhere;
  background: var(--panel); border-left: 5px solid var(--note); border-radius: 4px; }
.verdict.error { border-color: var(--error); } .verdict.warning { border-color: var(--warning); }
.verdict.good { border-color: var(--good); }
.tiles dl { display: grid; grid-template-columns: repeat(auto-fill, minmax(150px, 1fr)); gap: 10px; }
.tiles dl > div { background: var(--panel); border-radius: 6px; padding: 10px 14px; }
.tiles dt { color: var(--soft); font-size: 0.85rem; }
.tiles dd { margin: 0; font-size: 1.35rem; font-variant-numeric: tabular-nums; }
ol.findings { list-style: none; padding: 0; }
.finding { border: 1px solid var(--line); border-left: 5px solid var(--note); border-radius: 6px;
  padding: 12px 16px; margin: 10px 0; overflow-wrap: anywhere; }
.finding.error { border-left-color: var(--error); } .finding.warning { border-left-color: var(--warning); }
.finding p { margin: 6px 0 0; } .finding .sentence { font-size: 1.05rem; }
.depth-1 { margin-left: 28px; } .depth-2 { margin-left: 56px; }
.depth-3 { margin-left: 84px; }
.depth-4 { margin-left: 112px; }
.badge { font-weight: 600; } .badge.error { color: var(--error); } .badge.warning { color: var(--warning); }
.badge.note { color: var(--note); }
code { font-family: ui-monospace, "Cascadia Mono", Menlo, Consolas, monospace; font-size: 0.9em; }
figure { margin: 20px 0 28px; padding: 10px 12px; border: 1px solid var(--line); border-radius: 8px; }
figure h3 { margin: 2px 0 6px; }
figcaption { margin-top: 4px; }
.plot { width: 100%; }
.facts dl { columns: 2 440px; column-gap: 36px; }
.facts dl > div { display: grid; grid-template-columns: 9em 1fr; gap: 8px; padding: 4px 0;
  border-bottom: 1px solid var(--grid); break-inside: avoid; overflow-wrap: anywhere; }
.facts dt { color: var(--soft); } .facts dd { margin: 0; }
.wide { overflow-x: auto; margin: 16px 0; }
table { border-collapse: collapse; width: 100%; font-size: 0.9rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; color: var(--soft); padding: 4px 0; }
th, td { padding: 4px 10px; border-bottom: 1px solid var(--grid); text-align: left; vertical-align: top; }
th { border-bottom: 2px solid var(--line); }
th { vertical-align: bottom; }
th.n, td.n { text-align: right; } td.n { white-space: nowrap; }
td.t { overflow-wrap: anywhere; min-width: 8em; }
.ends { white-space: nowrap; }
details { margin: 12px 0; } summary { cursor: pointer; color: var(--link); }
pre { overflow-x: auto; padding: 10px 12px; background: var(--panel); font-size: 0.82rem; line-height: 1.35; }
footer { padding-top: 28px; padding-bottom: 40px; }
.plot .main-svg text { fill: var(--ink) !important; }
.plot .main-svg .hoverlayer text { fill: #ffffff !important; }
.plot .bars text { fill: #ffffff !important; }
.plot .gridlayer path { stroke: var(--grid) !important; }
.plot .xlines-above, .plot .ylines-above, .plot .zerolinelayer path { stroke: var(--line) !important; }
@media (max-width: 640px) { .depth-1, .depth-2, .depth-3, .depth-4 { margin-left: 14px; }
  header, nav, main, footer { padding-left: 12px; padding-right: 12px; } }
@page { margin: 14mm; }
@media print {
  :root, :root[data-theme=dark], :root:not([data-theme=light]) { color-scheme: light;
"""
    + _LIGHT
    + """ }
  body { font-size: 10.5pt; }
  .skip, .theme, nav, .screen, details { display: none !important; }
  header, main, footer { max-width: none; padding: 0; }
  .wide { overflow: visible; } table { font-size: 8pt; } th, td { padding: 2px 5px; }
  h2 { break-after: avoid; } h3 { break-after: avoid; }
  figure, .finding, .tiles, .verdict, tr { break-inside: avoid; }
  caption { break-after: avoid; } thead { display: table-header-group; break-after: avoid; }
  figure { border: none; padding: 0; } a { color: inherit; text-decoration: none; }
  * { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
}
"""
)
"""Colours of text reach 4.5 to one on their ground in both themes (WCAG 2.2, 1.4.3)."""
