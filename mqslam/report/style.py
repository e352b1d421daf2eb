"""The report's style sheet: light, dark, phone and print."""

from __future__ import annotations

from typing import Final

CSS: Final = """
:root {
  color-scheme: light dark;
  --ground: #f4f6f9; --card: #ffffff; --ink: #1c2430; --soft: #5b6675; --line: #dfe4ea;
  --pass: #15803d; --warn: #b45309; --fail: #c81e1e; --none: #5b6675; --warn-ground: #fff7e8;
}
* { box-sizing: border-box; }
body {
  margin: 0; background: var(--ground); color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Liberation Sans", sans-serif;
}
main, footer { max-width: 1320px; margin: 0 auto; padding: 0 20px; }
header { max-width: 1320px; margin: 0 auto; padding: 28px 20px 4px; }
h1 { margin: 0; font-size: 26px; line-height: 1.2; overflow-wrap: anywhere; }
h2 { margin: 32px 0 10px; font-size: 18px; }
h3 { margin: 0 0 8px; font-size: 15px; }
p { margin: 6px 0; }
.soft { color: var(--soft); }
.warnings {
  margin: 16px 0 0; padding: 12px 16px; background: var(--warn-ground); border: 1px solid var(--warn);
  border-left-width: 5px; border-radius: 8px; overflow-wrap: anywhere;
}
.warnings h2 { margin: 0 0 4px; font-size: 16px; color: var(--warn); }
.warnings ul, .verdict ul { margin: 0; padding-left: 20px; }
.verdict { display: flex; flex-wrap: wrap; gap: 8px 14px; align-items: center; margin-top: 16px; }
.badge {
  padding: 3px 14px; border-radius: 999px; color: #fff; background: var(--none);
  font-weight: 700; letter-spacing: .06em; text-transform: uppercase;
}
.badge.pass { background: var(--pass); }
.badge.warn { background: var(--warn); }
.badge.fail { background: var(--fail); }
.tiles { display: grid; grid-template-columns: repeat(auto-fit, minmax(190px, 1fr)); gap: 12px; margin-top: 18px; }
.tile, figure, .card { background: var(--card); border: 1px solid var(--line); border-radius: 10px; }
.tile { padding: 12px 16px; }
.tile b { display: block; font-size: 23px; line-height: 1.3; font-variant-numeric: tabular-nums; }
.tile span { color: var(--soft); font-size: 13px; }
.pair { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 16px; align-items: start; }
figure { margin: 0; padding: 12px; break-inside: avoid; }
figcaption { padding: 0 4px 8px; }
figcaption b { display: block; }
figcaption span { color: var(--soft); font-size: 13px; }
img { display: block; width: 100%; height: auto; }
.tables { display: grid; grid-template-columns: repeat(auto-fill, minmax(290px, 1fr)); gap: 16px; align-items: start; }
.card { padding: 14px 16px; break-inside: avoid; overflow-x: auto; }
.card.wide { grid-column: span 2; }
.stack { display: grid; gap: 16px; }
.halves { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 16px; }
.beside { display: grid; grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 10px; margin-top: 8px; }
.row { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 10px; }
.row > div, .row > a { max-width: 320px; }
.beside span, .row span { color: var(--soft); font-size: 13px; overflow-wrap: anywhere; }
table { width: 100%; border-collapse: collapse; font-size: 14px; }
th, td { padding: 4px 0 4px 10px; border-top: 1px solid var(--line); text-align: right; vertical-align: top; }
th:first-child { padding-left: 0; text-align: left; font-weight: 400; color: var(--soft); }
thead th { border-top: 0; font-weight: 600; color: var(--soft); }
td { font-variant-numeric: tabular-nums; overflow-wrap: anywhere; }
table.numbers td, .tile b { white-space: nowrap; }
table.numbers td.across { white-space: normal; text-align: left; }
details { margin-top: 12px; }
summary { cursor: pointer; font-weight: 600; }
pre { margin: 10px 0 0; overflow-x: auto; font: 13px/1.5 ui-monospace, "Liberation Mono", Menlo, monospace; }
footer { padding: 20px 20px 40px; color: var(--soft); font-size: 13px; overflow-wrap: anywhere; }
.live { display: none; }
.alive .live { display: block; }
.alive .still { display: none; }
.bar { display: flex; flex-wrap: wrap; gap: 8px 12px; align-items: center; margin: 8px 0 12px; }
.bar button, .bar select {
  font: inherit; color: var(--ink); background: var(--card); border: 1px solid var(--line); border-radius: 8px;
  padding: 4px 12px; cursor: pointer;
}
.live .pair { margin-top: 16px; }
#map { height: min(72vh, 820px); }
#charts { height: 500px; }
@media (max-width: 760px) {
  #map { height: min(70vh, 520px); }
  #charts { height: 400px; }
  .pair, .halves { grid-template-columns: minmax(0, 1fr); }
  .card.wide { grid-column: auto; }
  .tiles { grid-template-columns: repeat(2, minmax(0, 1fr)); }
  .tile { padding: 10px 12px; }
  .tile b { font-size: 19px; }
  header, main { padding-left: 12px; padding-right: 12px; }
  figure { padding: 8px; }
}
@media screen and (prefers-color-scheme: dark) {
  :root {
    --ground: #10141a; --card: #181e27; --ink: #e6eaf0; --soft: #9aa6b5; --line: #2b3442; --warn-ground: #2a2110;
    --warn: #d98a1f; --pass: #1f9d4f; --fail: #dc4444; --none: #5b6675;
  }
  img { filter: invert(1) hue-rotate(180deg); }
}
@media print {
  .alive .live { display: none; }
  .alive .still { display: block; }
  body { background: #fff; font-size: 11px; }
  header, main, footer { max-width: none; padding-left: 0; padding-right: 0; }
  h2, h2 + p { break-after: avoid; }
  h3 { font-size: 12px; }
  table, .tile span, figcaption span, .beside span, .row span { font-size: 10px; }
  table.numbers td { white-space: normal; overflow-wrap: normal; }
  th, td { padding-left: 6px; }
  .tile b { font-size: 16px; }
  .pair { grid-template-columns: repeat(2, minmax(0, 1fr)); gap: 8px; }
  .badge { print-color-adjust: exact; -webkit-print-color-adjust: exact; }
  pre { white-space: pre-wrap; }
}
"""
