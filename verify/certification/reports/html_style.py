"""The style sheet of index.html: two themes from one set of names, which the drawings use too.

Every text colour has a contrast of at least 4.5 to 1 on its ground in both themes; a test measures it in a browser.
"""

from __future__ import annotations

import base64
import hashlib

STYLE = """
:root{color-scheme:light dark;
--ground:#faf9f6;--sheet:#ffffff;--ink:#1c222b;--soft:#525c69;--rule:#dedad1;--faint:#ece9e2;--link:#0b5796;
--verified:#0a6648;--unknown:#7a5100;--falsified:#a3300f;--broken:#7b2480;
--verified-ground:#e5f3ec;--unknown-ground:#f8efdb;--falsified-ground:#fbe9e3;--broken-ground:#f5e6f6;
--pipe:#0072b2;--pipe-fill:#bcd9ea;--avoid:#b84a00;--goal:#00795a;--start:#1c222b;--witness:#b3260a}
@media(prefers-color-scheme:dark){:root{
--ground:#11151a;--sheet:#181d24;--ink:#e4e8ed;--soft:#a5afbc;--rule:#323a45;--faint:#232a33;--link:#85bdf0;
--verified:#6fd6ab;--unknown:#e6ba62;--falsified:#ff9a80;--broken:#e09be4;
--verified-ground:#123126;--unknown-ground:#33280f;--falsified-ground:#3b1c14;--broken-ground:#331936;
--pipe:#6bb9ec;--pipe-fill:#2b5877;--avoid:#ff9a62;--goal:#57d0a3;--start:#e4e8ed;--witness:#ff8a70}}
*{box-sizing:border-box}
html{-webkit-text-size-adjust:100%}
body{margin:0;background:var(--ground);color:var(--ink);font:16px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,
"Noto Sans",sans-serif;font-variant-numeric:tabular-nums;overflow-wrap:anywhere}
main,body>header,body>footer{max-width:72rem;margin:0 auto;padding:0 clamp(.9rem,3vw,2rem)}
body>header{padding-top:2.6rem}
body>footer{padding-top:1.5rem;padding-bottom:3rem;color:var(--soft);font-size:.875rem}
h1,h2,h3{font-family:Charter,"Bitstream Charter","Source Serif 4",Georgia,"Noto Serif",serif;line-height:1.25;
font-weight:600;text-wrap:balance}
h1{font-size:clamp(1.6rem,4.6vw,2.25rem);margin:.15rem 0 .4rem}
h2{font-size:1.4rem;margin:3rem 0 .7rem;padding-top:1.1rem;border-top:1px solid var(--rule)}
h3{font-size:1.05rem;margin:1.6rem 0 .5rem}
p{margin:.4rem 0 .8rem;max-width:46rem}
a{color:var(--link);text-underline-offset:.15em}
a:focus-visible,summary:focus-visible,.scroll:focus-visible{outline:2px solid var(--link);outline-offset:2px}
code,.digest{font-family:ui-monospace,"SF Mono",Menlo,Consolas,"Liberation Mono",monospace;font-size:.86em}
bdi,code{unicode-bidi:isolate}
.eyebrow{color:var(--soft);font-size:.8125rem;letter-spacing:.07em;text-transform:uppercase;margin:0}
.lead{font-size:1.1rem}
.soft,dt,figcaption,caption{color:var(--soft)}
nav{display:flex;flex-wrap:wrap;gap:.2rem 1.2rem;margin:1.1rem 0 0;font-size:.9375rem}
.counts{display:flex;gap:2px;height:12px;margin:1.3rem 0 .6rem;border-radius:6px;overflow:hidden}
.counts svg{display:block;width:100%;height:12px}
.legend{display:flex;flex-wrap:wrap;gap:.4rem 1.4rem;list-style:none;margin:.6rem 0;padding:0}
.badge{display:inline-flex;align-items:center;gap:.4em;padding:.1em .6em;border-radius:999px;font-size:.8125rem;
font-weight:600;letter-spacing:.02em;white-space:nowrap;border:1px solid currentColor}
.badge.verified{color:var(--verified);background:var(--verified-ground)}
.badge.unknown{color:var(--unknown);background:var(--unknown-ground);border-style:dashed}
.badge.falsified{color:var(--falsified);background:var(--falsified-ground);border-width:2px}
.badge.error,.badge.internal{color:var(--broken);background:var(--broken-ground);border-style:double;border-width:3px}
.gate-no{color:var(--falsified);font-weight:600;white-space:nowrap}
.worse{color:var(--falsified)}
.scroll{overflow-x:auto;-webkit-overflow-scrolling:touch;border:1px solid var(--rule);border-radius:8px;
background:var(--sheet)}
table{border-collapse:collapse;width:100%;font-size:.9rem}
.scroll>table{overflow-wrap:normal}
th,td{text-align:left;vertical-align:top;padding:.5rem .8rem;border-bottom:1px solid var(--faint)}
tr:last-child>td{border-bottom:0}
th{font-weight:600;color:var(--soft);font-size:.8125rem;white-space:nowrap;border-bottom-color:var(--rule)}
td.num,th.num{text-align:right;white-space:nowrap}
td.name{min-width:11rem;max-width:26rem;overflow-wrap:anywhere}
.charts{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,27rem),1fr));gap:1rem;align-items:start}
.stack{display:grid;gap:1rem;min-width:0}
figure{margin:0;border:1px solid var(--rule);border-radius:8px;background:var(--sheet);padding:.7rem .6rem .6rem;
min-width:0}
figure>.view{overflow-x:auto}
figure>.view>svg{display:block;width:100%;min-width:440px;max-width:560px;height:auto;margin:0 auto}
figcaption{font-size:.875rem;padding:.2rem .4rem 0}
details.row{border:1px solid var(--rule);border-radius:8px;background:var(--sheet);margin:.7rem 0}
details.row>summary{cursor:pointer;padding:.7rem 1rem;display:flex;flex-wrap:wrap;gap:.3rem 1rem;
align-items:baseline;list-style-position:inside}
details.row>summary::before{content:"▸";color:var(--soft)}
details.row[open]>summary::before{content:"▾"}
details.row>summary::-webkit-details-marker{display:none}
details.row>summary{list-style:none}
summary .title{font-weight:600;flex:1 1 14rem;min-width:0}
.inside{padding:.2rem 1rem 1.2rem;border-top:1px solid var(--faint);scroll-margin-top:5rem}
.inside>p:first-child{margin-top:.9rem}
.claim{border-left:3px solid var(--verified);padding-left:.9rem}
.reason{border-left:3px solid var(--unknown);padding-left:.9rem}
.reason.falsified{border-color:var(--falsified)}
.reason.error,.reason.internal{border-color:var(--broken)}
dl{display:grid;grid-template-columns:minmax(7rem,max-content) 1fr;gap:.25rem 1.2rem;margin:.4rem 0;font-size:.9375rem}
dd{margin:0;min-width:0}
ul{margin:.3rem 0 .8rem;padding-left:1.2rem}
.digest{color:var(--soft);font-size:.8125rem}
.defs{position:absolute;width:0;height:0}
svg text{font:12px system-ui,-apple-system,"Segoe UI",Roboto,"Noto Sans",sans-serif;fill:var(--ink)}
svg .tick,svg .axis-name{fill:var(--soft)}
svg .note,svg .name{paint-order:stroke;stroke:var(--sheet);stroke-width:3.5px;stroke-linejoin:round}
svg .name{font-weight:600}
svg .avoid-name,svg .stay-name{fill:var(--avoid)}
svg .reach-name{fill:var(--goal)}
.grid{stroke:var(--faint);fill:none}
.axis{stroke:var(--soft);fill:none}
.pipe{fill:var(--pipe-fill);stroke:var(--pipe-fill);stroke-width:.7}
.pipe-times{fill:var(--pipe-fill);stroke:var(--pipe);stroke-opacity:.3;stroke-width:.7}
.pipe-points{fill:none;stroke:var(--pipe);stroke-width:.8}
.avoid,.outside{fill:var(--avoid);fill-opacity:.13}
.avoid-edge{fill:url(#hatch-avoid);stroke:var(--avoid);stroke-width:1.3}
.outside-edge{fill:url(#hatch-outside);stroke:var(--avoid);stroke-width:1}
.reach,.stay{fill:var(--goal);fill-opacity:.1}
.reach-edge,.stay-edge{fill:url(#dots-goal);stroke:var(--goal);stroke-width:1.5;stroke-dasharray:5 3}
.hatch{stroke:var(--avoid);stroke-width:.8}
.dots{fill:var(--goal)}
.start{fill:none;stroke:var(--start);stroke-width:2}
.clock,.dot{fill:var(--ink)}
.witness{fill:none;stroke:var(--witness);stroke-width:1.8}
.witness-mark,.mark-falsified{fill:none;stroke:var(--witness);stroke-width:2.6}
.curve{fill:none;stroke:var(--pipe);stroke-width:1.8}
.unproved{stroke-dasharray:3 4}
.zero{stroke:var(--ink);stroke-width:1}
.below-zero{fill:url(#hatch-avoid);stroke:none}
.radius{stroke:var(--verified);stroke-width:5;stroke-opacity:.3;fill:none}
.mark-verified{fill:var(--verified);stroke:var(--sheet)}
.mark-claimed{fill:var(--soft);stroke:var(--sheet)}
.mark-unknown{fill:var(--sheet);stroke:var(--unknown);stroke-width:2}
.share-verified{fill:var(--verified)}
.share-unknown{fill:var(--unknown)}
.share-falsified{fill:var(--falsified)}
.share-error,.share-internal{fill:var(--broken)}
@media(max-width:40rem){dl{grid-template-columns:1fr;gap:0}dd{margin-bottom:.5rem}.inside{padding:.2rem .75rem 1rem}}
@media print{body{background:#fff}details.row{break-inside:avoid-page}.scroll{overflow:visible}
details::details-content{content-visibility:visible;display:block}}
"""

POLICY = (
    "default-src 'none'; base-uri 'none'; form-action 'none'; style-src 'sha256-"
    f"{base64.b64encode(hashlib.sha256(STYLE.encode()).digest()).decode()}'"
)
"""Content security policy of the page: this style sheet, by its digest, and nothing else."""
