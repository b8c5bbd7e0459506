var e=e=>e.kind===`drive`?e.drive_id:`${e.drive_id} (imported map)`,t=class extends Error{status;body;constructor(e,t,n=null){super(e),this.status=t,this.body=n}},n=null,r=e=>void(n=e);async function i(e,t={}){let r=await o(e,t);return r.status!==401||!n||!r.headers.get(`WWW-Authenticate`)?.includes(`realm`)?c(r):(await n(),c(await o(e,t)))}var a=async e=>(await o(`maps${p({token:e})}`,{})).ok;async function o(e,n){try{return await fetch(`./api/${e}`,n)}catch(e){throw e instanceof DOMException&&e.name===`AbortError`?e:new t("The server does not answer. Check that `conetl view` is running, then try again.",0)}}function s(e){let t=e?.detail;return Array.isArray(t)?t.map(({loc:e,msg:t})=>`${e.at(-1)}: ${t}`).join(`; `):t??null}async function c(e){if(e.ok)return e;let n=`The server answered ${e.status}.`,r=null;try{r=await e.json(),n=s(r)??n}catch{}throw new t(n,e.status,r)}var l=new Map;async function u(e,t={}){let n=l.get(e);return n?(l.delete(e),await n):await(await i(e,t)).json()}var d=(e,t)=>`maps/${encodeURIComponent(e)}/${t}`,f=(e,t,n)=>u(d(e,t),n);function p(e){let t=Object.entries(e).flatMap(([e,t])=>t===null?[]:[t].flat().map(t=>[e,t]));return t.length?`?${new URLSearchParams(t).toString()}`:``}function m(e,t){l.set(`maps`,Promise.resolve(t));for(let t of[`timeline`,`decisions`,`base`,`base/lines`]){let n=d(e,t),r=u(n);r.catch(()=>void 0),l.set(n,r)}}var h=(e,t)=>({method:`POST`,headers:{"Content-Type":`application/json`,...t&&{Authorization:`Bearer ${t}`}},body:JSON.stringify(e)}),g={maps:()=>u(`maps`),projection:(e,[t,n])=>f(e,`projection${p({x_m:String(t),y_m:String(n)})}`),timeline:e=>f(e,`timeline`),summary:(e,t)=>f(e,`summary${p({valid_at:t.valid,known_at:t.known})}`),tile:(e,t,n)=>f(e,`tiles/${t}${p({valid_at:n.valid,known_at:n.known})}`),featurePage:(e,t)=>f(e,`features${p(t)}`),changePage:(e,t)=>f(e,`changes${p(t)}`),listCount:(e,t,n)=>f(e,`${t}/count${p(n)}`),changeSummary:(e,t)=>f(e,`changes/summary${p(t)}`),changesInView:(e,t)=>f(e,`changes/view${p(t)}`),history:(e,t,n)=>f(e,`features/${t}${p({known_at:n})}`),sightings:(e,t)=>f(e,`features/${t}/sightings`),trajectory:(e,t)=>f(e,`drives/${t}/trajectory`),search:(e,t)=>f(e,`search${p({text:t})}`),download:(e,t,n)=>`./api/${d(e,`downloads/${t}${p(n)}`)}`,report:(e,t)=>`./api/${d(e,`changesets/${t}/report`)}`,zones:(e,t)=>f(e,`work-zones${p({valid_at:t})}`),differences:e=>f(e,`differences`),judge:(e,t,n,r)=>f(e,`differences/${t}`,h(n,r)),base:e=>f(e,`base`),baseLines:e=>f(e,`base/lines`),baseTile:async(e,t)=>(await i(d(e,`base/tiles/${t}.bin`))).arrayBuffer(),passes:(e,t,n)=>f(e,`features/${t}/passes${p({version:n===null?null:String(n)})}`),frame:(e,t,n)=>f(e,`drives/${t}/frames/${n}`),image:async(e,t,n,r,a)=>(await i(d(e,`drives/${t}/frames/${n}/${r}.jpg${p({feature_id:a})}`))).blob(),review:(e,t,n)=>f(e,`review${p({offset:String(t),limit:String(n)})}`),decisions:e=>f(e,`decisions`),decide:(e,t,n)=>f(e,`decisions`,h(t,n)),events:e=>new EventSource(`./api/${d(e,`events`)}`)};function _(e,t={},...n){let r=document.createElement(e),{class:i,data:a,aria:o,role:s,...c}=t;i&&(r.className=i),s&&r.setAttribute(`role`,s);for(let[e,t]of Object.entries(a??{}))r.dataset[e]=t;for(let[e,t]of Object.entries(o??{}))r.setAttribute(`aria-${e}`,t);Object.assign(r,c);for(let e of n)e&&r.append(e);return r}function v(e,t,n=()=>void 0){let r=r=>{t.hidden=!r,e.setAttribute(`aria-expanded`,String(r)),r&&n()};e.addEventListener(`click`,()=>r(t.hidden));for(let n of[e,t])n.addEventListener(`keydown`,n=>{n.key!==`Escape`||t.hidden||(n.stopPropagation(),r(!1),e.focus())});return r}var y=/^(Arrow|Home|End|Page)/;function b(e,...t){e.replaceChildren(...t.filter(e=>!!e))}var x=e=>String(e).padStart(2,`0`);function S(e,t=!0){let n=new Date(e);return`${`${n.getUTCFullYear()}-${x(n.getUTCMonth()+1)}-${x(n.getUTCDate())}`} ${x(n.getUTCHours())}:${x(n.getUTCMinutes())}${t?`:${x(n.getUTCSeconds())}`:``}`}var C=new Intl.DateTimeFormat(`en-GB`,{day:`2-digit`,month:`short`,hour:`2-digit`,minute:`2-digit`,timeZoneName:`short`}),w=new Intl.DateTimeFormat(`en-GB`,{hour:`2-digit`,minute:`2-digit`,timeZoneName:`short`});function T(e,t=!0){let n=new Date(e),r=n.getTimezoneOffset()===0?``:` (${(n.getDate()===n.getUTCDate()?w:C).format(n)})`;return`${S(e,t)} UTC${r}`}function E(e,t,n=`${t}s`){return`${e.toLocaleString(`en`)} ${e===1?t:n}`}var D=e=>e<5e-4?`<0.001`:e>=.9995?`>0.999`:e.toFixed(3),O=e=>e<.005?`<1 %`:e>=.995?`>99 %`:`${(100*e).toFixed(0)} %`,k=e=>e<.0095?`${(1e3*e).toFixed(0)} mm`:e<.995?`${(100*e).toFixed(0)} cm`:`${e.toFixed(1)} m`,A=e=>e===null?`as known now`:`as known at ${T(e)}`,j=e=>e instanceof Error?e.message:String(e),M=e=>e.slice(0,8);function N(e,t){let n=new Map;for(let[r,{id:i,cov:a}]of e.entries()){if(!a||i===null)return null;let e=n.get(i)??{g:[0,0],cov:a};e.g[0]+=t[r]?.[0]??0,e.g[1]+=t[r]?.[1]??0,n.set(i,e)}let r=0;for(let{g:[e,t],cov:[i,a,o]}of n.values())r+=e*e*i+2*e*t*a+t*t*o;return Math.sqrt(r)}function P(e){let t=e.map(()=>[0,0]),n=0;for(let r=1;r<e.length;r++){let[i,a]=[e[r-1].xyz,e[r].xyz],[o,s]=[a[0]-i[0],a[1]-i[1]],c=Math.hypot(o,s);if(n+=c,c)for(let[e,n]of[[r-1,-1],[r,1]])t[e][0]+=n*o/c,t[e][1]+=n*s/c}return{value:n,sigma:N(e,t)}}function ee(e){let t=t=>e[(t+e.length)%e.length].xyz,[n,r]=t(0),i=e.reduce((e,i,a)=>e+(t(a)[0]-n)*(t(a+1)[1]-r)-(t(a+1)[0]-n)*(t(a)[1]-r),0),a=Math.sign(i)||1,o=e.map((e,n)=>[a*(t(n+1)[1]-t(n-1)[1])/2,a*(t(n-1)[0]-t(n+1)[0])/2]);return{value:Math.abs(i)/2,sigma:N(e,o)}}function F([e,t,n]){let[r,i]=[t.xyz[0]-e.xyz[0],t.xyz[1]-e.xyz[1]],[a,o]=[n.xyz[0]-e.xyz[0],n.xyz[1]-e.xyz[1]],s=Math.hypot(r,i),c=r*o-i*a,l=Math.sign(c)||1,[u,d]=[-i/s*l,r/s*l],f=(r*a+i*o)/(s*s);return{value:Math.abs(c)/s,sigma:N([e,t,n],[[-u*(1-f),-d*(1-f)],[-u*f,-d*f],[u,d]])}}function te({value:e,sigma:t},n){if(t===null)return`${e.toFixed(2)} ${n}`;let r=t<.0095?3:2;return`${e.toFixed(r)} ± ${t.toFixed(r)} ${n}`}var ne=`http://www.w3.org/2000/svg`;function re(e,t,n){let r=`line`,i=[],a=!1,o=``,s=0,c=document.createElementNS(ne,`path`),l=document.createElementNS(ne,`g`),u=document.createElementNS(ne,`svg`);u.setAttribute(`class`,`measure-shape`),u.setAttribute(`aria-hidden`,`true`),u.append(c,l);let d=_(`div`,{class:`labels`,aria:{hidden:`true`}}),f=[[`line`,`Distance`],[`area`,`Area`]].map(([e,t])=>_(`button`,{type:`button`,textContent:t,data:{value:e},onclick:()=>(r=e,C())})),p=_(`div`,{class:`measure-result`,role:`status`,aria:{live:`polite`}}),m=_(`button`,{type:`button`,textContent:`Copy`,onclick:()=>void O()}),h=_(`button`,{type:`button`,textContent:`Undo`,title:`Remove the last point (Backspace)`,onclick:()=>E()}),v=_(`section`,{class:`measure`,hidden:!0,aria:{label:`Measure`}},_(`div`,{class:`measure-head`},_(`div`,{class:`segmented`,role:`group`,aria:{label:`What to measure`}},...f),_(`button`,{type:`button`,class:`close`,textContent:`×`,title:`Close (Esc)`,aria:{label:`End measuring`},onclick:()=>D()})),p,_(`div`,{class:`measure-actions`},m,h));t.append(u,d,v),e.beforeDraw(()=>{a&&y()});function y(){let t=i.map(({xyz:t})=>e.project(t)),n=t.every(e=>e!==null)?t.map(([e,t])=>`${e.toFixed(1)} ${t.toFixed(1)}`):[];c.setAttribute(`d`,n.length>1?`M${n.join(`L`)}${r===`area`&&n.length>2?`Z`:``}`:``),c.setAttribute(`class`,r),[...l.children].forEach((e,n)=>{let r=t[n];e.setAttribute(`visibility`,r?`visible`:`hidden`),r&&e.setAttribute(`transform`,`translate(${r[0].toFixed(1)} ${r[1].toFixed(1)})`)}),[...d.children].forEach((e,n)=>{let[r,i]=[t[n],t[(n+1)%t.length]],a=e;a.hidden=!r||!i||Math.hypot(r[0]-i[0],r[1]-i[1])<40,r&&i&&(a.style.transform=`translate(${Math.round((r[0]+i[0])/2)}px, ${Math.round((r[1]+i[1])/2)}px)`)})}function x(){v.hidden=!a,u.style.display=a?``:`none`,d.hidden=!a,t.classList.toggle(`measuring`,a);for(let e of f)e.setAttribute(`aria-pressed`,String(e.dataset.value===r));l.replaceChildren(...i.map(({id:e})=>{let t=document.createElementNS(ne,`circle`);return t.setAttribute(`r`,e?`5`:`3.5`),t.setAttribute(`class`,e?`snapped`:`free`),t}));let n=i.slice(1).map((e,t)=>[i[t],e]);r===`area`&&i.length>2&&n.push([i.at(-1),i[0]]),d.replaceChildren(...n.map(e=>_(`span`,{class:`measure-label`,textContent:te(P(e),`m`)}))),h.disabled=!i.length;let s=S();m.disabled=!s.length;let c=i.filter(e=>e.id===null).length;b(p,...s.map(([e,t],n)=>_(`div`,{class:n?`row`:`row total`},_(`span`,{textContent:e}),_(`b`,{textContent:t}))),_(`p`,{class:`hint`,textContent:s.length?c?`Points on the ground have no sigma; cones do.`:`Horizontal, 1 sigma; errors of the cones are taken as independent.`:`Click ${r===`line`?`two`:`three`} or more cones or points on the ground.`})),o=s.map(([e,t])=>`${e}\t${t}`).join(`
`),y(),e.draw()}function S(){if(i.length<2||r===`area`&&i.length<3)return[];let e=i.map((e,t)=>e.id?M(e.id):`point ${t+1}`);if(r===`area`)return[[`Area`,te(ee(i),`m²`)],[`Perimeter`,te(P([...i,i[0]]),`m`)]];let t=[[i.length>2?`Total`:`Distance`,te(P(i),`m`)]],[n,a,o]=[i[0],i[1],i.at(-1)];if(i.length>2&&Math.hypot(n.xyz[0]-a.xyz[0],n.xyz[1]-a.xyz[1])>0&&t.push([`Last point to line 1–2`,te(F([n,a,o]),`m`)]),i.length>2)for(let n=1;n<i.length;n++)t.push([`${e[n-1]} – ${e[n]}`,te(P([i[n-1],i[n]]),`m`)]);return t}function C(){a=!0,n.changed(w()),x()}let w=()=>[r,...i.map(e=>e.id??e.xyz.map(e=>e.toFixed(3)).join(`,`))].join(`:`);async function T(e){let t={xyz:e.xyz,id:e.id,cov:null};i.push(t),C();let{history:r}=await g.history(n.map(),e.id,null),o=t=>Math.hypot(t.xyz_m[0]-e.xyz[0],t.xyz_m[1]-e.xyz[1]),s=r.reduceRight((e,t)=>e===null||o(t)<o(e)-1e-4?t:e,null);s&&(t.cov=[s.cov_m2[0],s.cov_m2[1],s.cov_m2[3]]),a&&x()}function E(){i.pop(),C()}function D(){a=!1,i=[],n.changed(null),x()}async function O(){await ie(o),m.textContent=`Copied`,window.setTimeout(()=>m.textContent=`Copy`,1500)}return{active:()=>a,toggle:()=>a?D():C(),end:D,click(e,t){return a?(e?T(e).catch(()=>x()):t&&(i.push({xyz:t,id:null,cov:null}),C()),!0):!1},key(e){if(e.key===`m`||e.key===`M`)a?D():C();else if(a&&e.key===`Backspace`&&i.length)E();else return!1;return!0},open(e){if(e===(a?w():null))return;let t=++s;a=e!==null,i=[];let[o,...c]=(e??``).split(`:`);r=o===`area`?`area`:`line`,(async()=>{for(let e of c){let r=n.cone(e),a=e.split(`,`).map(Number);if(r?await T(r).catch(()=>void 0):a.length===3&&a.every(Number.isFinite)&&i.push({xyz:a,id:null,cov:null}),t!==s)return}x()})(),x()}}}async function ie(e){try{await navigator.clipboard.writeText(e)}catch{let t=_(`textarea`,{value:e,class:`offscreen`});document.body.append(t),t.select(),document.execCommand(`copy`),t.remove()}}var I=location.pathname.endsWith(`/embed.html`);function ae(e){async function t(t,n,r){await ie(t),e.said(n,r)}let n=()=>{t(`<iframe src="${(new URL(`embed.html`,location.href).href+location.hash).replaceAll(`&`,`&amp;`).replaceAll(`"`,`&quot;`)}" title="${document.title}" width="800" height="500"></iframe>`,`The code of a frame is copied. It shows this view, read-only.`,null)};return _(`button`,{type:`button`,class:`link`,id:`share`,textContent:`Share`,title:`Copy a link that opens this view`,onclick:()=>{e.write(),t(location.href,`The link is copied. It opens this view.`,e.mayEmbed()?{text:`Copy code of a frame`,run:n}:null)}})}var oe=()=>_(`a`,{class:`whole-link`,target:`_blank`,rel:`noopener`,textContent:`Open the map viewer`,href:`./`,onclick:e=>{e.currentTarget.href=`./${location.hash}`}}),L={added:{colour:`#002e9a`,dark:`#afdafb`,shape:1,label:`added`},moved:{colour:`#821773`,dark:`#e054d9`,shape:2,label:`moved`},removed:{colour:`#1f2933`,dark:`#e6ebf0`,shape:3,label:`removed`},split:{colour:`#002e9a`,dark:`#afdafb`,shape:6,label:`split off`},merged:{colour:`#1f2933`,dark:`#e6ebf0`,shape:7,label:`merged`},height_changed:{colour:`#006a54`,dark:`#2fedaf`,shape:5,label:`height changed`},missed:{colour:`#8a54e4`,dark:`#9b45ff`,shape:4,label:`not observed`},confirmed:{colour:`#7c93a2`,dark:`#84a3bb`,shape:0,label:`confirmed`},unchanged:{colour:`#b4bcc6`,dark:`#616c78`,shape:0,label:`not evaluated`},suppressed:{colour:`#66717c`,dark:`#98a3ae`,shape:3,label:`suppressed`},standing:{colour:`#d64f00`,dark:`#ff8c42`,shape:8,label:`standing`}},R=[`added`,`split`,`moved`,`removed`,`merged`,`height_changed`,`missed`,`suppressed`,`confirmed`,`unchanged`,`standing`],se=e=>e===`removed`||e===`merged`||e===`suppressed`,ce=`http://www.w3.org/2000/svg`,le=[`M8 3.2a4.8 4.8 0 1 0 .01 0z`,`M6.5 2h3v4.5H14v3H9.5V14h-3V9.5H2v-3h4.5z`,`M8 1.5 14.5 8 8 14.5 1.5 8z`,`M3.600 1.800 8 6.200l4.400-4.400 1.800 1.800L9.800 8l4.400 4.400-1.800 1.800L8 9.800l-4.400 4.400-1.800-1.800L6.200 8 1.800 3.600z`,`M8 2.200a5.800 5.800 0 1 0 .01 0zM8 4.900a3.100 3.100 0 1 1 -.01 0z`,`M3.200 3.200h9.600v9.600H3.200z`,`M8 2 14 13.200H2z`,`M8 14 2 2.800h12z`,`M7.2 1.5h1.6l3.2 10.5h2v2.5H2V12h2z`],ue=e=>de(le[L[e].shape]??``,`var(--kind-${e})`);function de(e,t){let n=document.createElementNS(ce,`svg`);n.setAttribute(`viewBox`,`0 0 16 16`),n.setAttribute(`class`,`icon`),n.setAttribute(`aria-hidden`,`true`);let r=document.createElementNS(ce,`path`);return r.setAttribute(`d`,e),r.style.fill=t,n.append(r),n}var fe=`traffic_cone`,pe=new Map([[fe,{label:`Traffic cone`,width:.55,glyph:`M7.2 1.5h1.6l3.2 10.5h2v2.5H2V12h2z`}],[`tubular_marker`,{label:`Tubular marker`,width:.3,glyph:`M6.5 1h3v11H12v3H4v-3h2.5z`}],[`drum`,{label:`Drum`,width:.65,glyph:`M3.5 1.8Q8 .2 12.5 1.8v12.4Q8 15.8 3.5 14.2z`}],[`vertical_panel`,{label:`Vertical panel`,width:.4,glyph:`M4.5 .8h7v11H14V15H2v-3.2h2.5z`}],[`barricade`,{label:`Barricade`,width:1.2,glyph:`M.8 3h14.4v6.5h-1.7V15h-2.7V9.5H5.2V15H2.5V9.5H.8z`}],[`work_zone_sign`,{label:`Work-zone sign`,width:1,glyph:`M8 .5 15.5 8 8 15.5.5 8z`}],[`arrow_board`,{label:`Arrow board`,width:1.5,glyph:`M.6 5.2H8V1.5L15.4 8 8 14.5v-3.7H.6z`}],[`traffic_sign`,{label:`Traffic sign`,width:.9,glyph:`M8 .6a6 6 0 0 1 1.3 11.85V15.5H6.7v-3.05A6 6 0 0 1 8 .6z`}],[`lane_marking`,{label:`Lane marking`,width:30,glyph:`M6.6 .8h2.8v6H6.6zM6.6 9.2h2.8v6H6.6z`}]]),me={width:.55,glyph:`M2.5 2.5h11v11h-11z`},he=[...pe.keys()],ge=[...pe.values(),me].map(e=>e.glyph),_e=e=>pe.get(e)??{...me,label:e.charAt(0).toUpperCase()+e.slice(1).replaceAll(`_`,` `)},ve=e=>(he.indexOf(e)+ge.length)%ge.length,ye=e=>e===`traffic_cone`?`cone`:_e(e).label.toLowerCase(),z=e=>de(_e(e).glyph,`var(--soft)`),be=new Map;function xe(e,t){let n=new Map([...t].filter(([,e])=>e>0));for(let{category:t}of e)n.set(t,(n.get(t)??0)+1);be=new Map([...n].sort(([e],[t])=>ve(e)-ve(t)))}var Se=()=>be,B=()=>[...be.keys()].every(e=>e===fe),Ce=e=>E(e,B()?`cone`:`object`),V=[[`maxProbability`,`pmax`,1],[`maxSigma_m`,`smax`,100],[`minHeight_m`,`hmin`,100],[`maxHeight_m`,`hmax`,100],[`drive`,`drive`,0x38d7ea4c68000]],H=[[`seenFrom`,`seenfrom`],[`seenTo`,`seento`]],we=`hideclass`,Te=864e5,Ee=()=>({maxProbability:null,maxSigma_m:null,minHeight_m:null,maxHeight_m:null,drive:null,seenFrom:null,seenTo:null,hiddenClasses:null}),De=e=>/^\d{4}-\d\d-\d\d$/.test(e)&&!Number.isNaN(Date.parse(e));function Oe(e,t){let n=Ee();for(let[r,i,a]of V){let o=e.get(i);if(o===null)continue;let s=Number(o);o.trim()&&s>=0&&s<=a?n[r]=s:t(i,`a number from 0 to ${a}`)}for(let[r,i]of H){let a=e.get(i);a!==null&&(De(a)?n[r]=a:t(i,`a day such as 2026-03-02`))}return n.hiddenClasses=e.get(we)?.split(`,`)??null,n}function ke(e,t){for(let[n,r]of[...V,...H,[`hiddenClasses`,we]])e[n]!==null&&t.set(r,String(e[n]))}function Ae(e){let{hidden:t,minProbability:n,filter:r}=e,i=r.seenFrom===null?-1/0:Date.parse(r.seenFrom),a=r.seenTo===null?1/0:Date.parse(r.seenTo)+Te,o=r.maxProbability??1,s=r.maxSigma_m??1/0,[c,l]=[r.minHeight_m??0,r.maxHeight_m??1/0],u=r.hiddenClasses;return e=>!t.has(e.kind)&&!u?.includes(e.category)&&e.probability>=n&&e.probability<=o&&e.sigma_m<=s&&e.height_m>=c&&e.height_m<=l&&(r.drive===null||e.changeset===r.drive)&&e.seenAt>=i&&e.seenAt<a}function je({hidden:e,minProbability:t,filter:n,inView:r},i,a){let o=e=>e===null?null:String(e),s=R.filter(t=>!e.has(t));return{kinds:i&&e.size?s.length?s:[`none`]:null,hidden_classes:n.hiddenClasses,least_existence:o(t||null),most_existence:o(n.maxProbability),most_sigma_m:o(n.maxSigma_m),least_height_m:o(n.minHeight_m),most_height_m:o(n.maxHeight_m),of_changeset:o(n.drive),seen_from:n.seenFrom&&`${n.seenFrom}T00:00:00Z`,seen_before:n.seenTo&&new Date(Date.parse(n.seenTo)+Te).toISOString(),area:r?a():null}}var Me=({hidden:e,minProbability:t,filter:n})=>Number(e.size>0)+Number(t>0)+Object.values(n).filter(e=>e!==null).length,Ne=()=>({hidden:new Set,minProbability:0,filter:Ee()});function Pe(e,t){let n=R.filter(e=>e!==t),r=!e.hidden.has(t)&&n.every(t=>e.hidden.has(t));return new Set(r?[]:n)}function Fe(e,t){let{hiddenClasses:n}=e,r=n?.includes(t)?n.filter(e=>e!==t):[...n??[],t];return{...e,hiddenClasses:r.length?r:null}}function Ie(t){let n=null,r=e=>n&&t.change({filter:{...n.filter,...e}},!1),i=_(`div`,{class:`kind-chips`,role:`group`,aria:{label:`Kinds`}}),a=_(`span`,{class:`filter-summary`,role:`status`}),o=_(`button`,{type:`button`,class:`link`,textContent:`clear`,onclick:()=>t.change(Ne(),!1)}),s=_(`button`,{type:`button`,class:`filter-more`,aria:{expanded:`false`,controls:`filter-fields`}}),c=_(`input`,{type:`checkbox`,id:`in-view`,onchange:()=>t.change({inView:c.checked},!1)});function l(e,t,n,r){let i=_(`input`,{type:`number`,min:`0`,step:t,aria:{label:e}});return i.addEventListener(`input`,()=>{i.validity.valid&&r(i.value===``?null:Number(i.value))}),{input:i,show:()=>document.activeElement!==i&&(i.value=String(n()??``))}}let u=(e,t,i)=>l(e,t,()=>n?.filter[i]??null,e=>r({[i]:e})),d=l(`Minimum existence probability`,`0.01`,()=>n?.minProbability||null,e=>t.change({minProbability:Math.min(e??0,1)},!1)),f=u(`Maximum existence probability`,`0.01`,`maxProbability`),p=u(`Maximum horizontal sigma in metres`,`0.001`,`maxSigma_m`),m=u(`Minimum object height in metres`,`0.01`,`minHeight_m`),h=u(`Maximum object height in metres`,`0.01`,`maxHeight_m`);for(let{input:e}of[d,f])e.max=`1`;let g=_(`select`,{aria:{label:`Drive that last observed or changed the cone`},onchange:()=>r({drive:g.value===``?null:Number(g.value)})}),v=(e,t)=>{let i=_(`input`,{type:`date`,aria:{label:e}});return i.addEventListener(`change`,()=>r({[t]:i.value||null})),{input:i,show:()=>document.activeElement!==i&&(i.value=n?.filter[t]??``)}},[y,x]=[v(`Last seen from`,`seenFrom`),v(`Last seen until`,`seenTo`)],C=(e,...t)=>_(`div`,{class:`filter-field`},_(`span`,{textContent:e}),...t),w=_(`div`,{class:`filter-fields`,id:`filter-fields`,hidden:!0},C(`Existence`,d.input,`–`,f.input),C(`Sigma ≤`,p.input,`m`),C(`Object height`,m.input,`–`,h.input,`m`),C(`Drive`,g),C(`Last seen`,y.input,`–`,x.input));s.addEventListener(`click`,()=>{w.hidden=!w.hidden,s.setAttribute(`aria-expanded`,String(!w.hidden))});let T=_(`div`,{class:`filter-bar`},_(`div`,{class:`filter-line`},i,s,_(`label`,{class:`check`},c,`Only in view`),_(`span`,{class:`space`}),a),w),E=null;return{node:T,show(t,r,l,u,v){n=t;let C=i.contains(document.activeElement)?document.activeElement.dataset.kind:void 0;b(i,...R.filter(e=>r.has(e)).map(e=>D(t,e,r.get(e)??0))),C&&i.querySelector(`[data-kind="${C}"]`)?.focus();let w=Me(t)-Number(t.hidden.size>0)-Number(t.filter.hiddenClasses!==null);s.textContent=w?`Filters (${w})`:`Filters`,c.checked=t.inView,v!==E&&(E=v,b(g,_(`option`,{value:``,textContent:`any`}),...[...v].reverse().map(t=>_(`option`,{value:String(t.changeset_no),textContent:`${S(t.captured_from,!1).slice(0,10)} · ${e(t)}`})))),g.value=String(t.filter.drive??``);for(let e of[d,f,p,m,h,y,x])e.show();let T=l-u,O=t.inView?Me(t)?`by filters or outside the view`:`outside the view`:`by filters`;b(a,T?`${Ce(T)} hidden ${O}`:Ce(l),Me(t)>0&&` – `,Me(t)>0&&o)}};function D(e,n,r){let i=!e.hidden.has(n),a=Le(n,e);return _(`button`,{type:`button`,class:`chip`,title:`${i?`Hide`:`Show`} “${a}”; double-click: show only these`,data:{kind:n},aria:{pressed:String(i)},onclick:()=>{let r=new Set(e.hidden);r.delete(n)||r.add(n),t.change({hidden:r},!1)},ondblclick:()=>t.change({hidden:Pe(e,n)},!1)},ue(n),a,_(`b`,{textContent:r.toLocaleString(`en`)}))}}var Le=(e,t)=>e===`unchanged`&&t.mode===`compare`?`unchanged`:L[e].label,Re={plan:!1,colouring:`intensity`,shading:!1,size:1,opacity:1,basemap:1,grid:`lines`,swipe:null,follow:!1,paper:!1,measure:null,at:null},ze=[`intensity`,`height`,`one`],Be=[`none`,`lines`,`labels`];function Ve(e,t,n,r){let i=e===null||e===``?NaN:Number(e);return i>=t&&i<=n?i:r}function He(e){e.get(`colours`);let t=(e.get(`at`)??``).split(`,`).map(e=>e===``?NaN:Number(e)),n=Ve(e.get(`swipe`),0,1,NaN);return{plan:e.get(`view`)===`plan`,colouring:ze.find(t=>t===e.get(`colour`))??Re.colouring,shading:e.get(`shading`)===`1`,size:Ve(e.get(`size`),.5,4,Re.size),opacity:Ve(e.get(`opacity`),.05,1,Re.opacity),basemap:Ve(e.get(`basemap`),0,1,Re.basemap),grid:Be.find(t=>t===e.get(`grid`))??Re.grid,swipe:e.get(`swipe`)===`split`?`split`:Number.isNaN(n)?null:n,follow:e.get(`follow`)===`1`,paper:e.get(`look`)===`paper`,measure:e.get(`measure`),at:t.length===2&&t.every(Number.isFinite)?t:null}}function Ue(e,t,n){t.plan&&e.set(`view`,`plan`),t.colouring!==Re.colouring&&e.set(`colour`,t.colouring),t.shading&&e.set(`shading`,`1`);for(let n of[`size`,`opacity`,`basemap`])t[n]!==Re[n]&&e.set(n,String(t[n]));t.grid!==Re.grid&&e.set(`grid`,t.grid),n&&t.swipe!==null&&e.set(`swipe`,t.swipe===`split`?t.swipe:t.swipe.toFixed(3).replace(/\.?0+$/,``)||`0`),t.paper&&e.set(`look`,`paper`),t.follow&&e.set(`follow`,`1`),t.at!==null&&e.set(`at`,t.at.map(e=>e.toFixed(3)).join(`,`)),t.measure!==null&&e.set(`measure`,t.measure)}function We(){return{map:``,mode:`instant`,changeset:null,side:`changes`,from:0,to:null,valid:null,known:null,hidden:new Set,minProbability:0,filter:Ee(),inView:!1,sort:null,mark:null,feature:null,image:null,trajectory:!0,points:!0,lines:!0,scene:Re,list:null,camera:null}}var Ge=[`instant`,`drive`,`compare`],Ke=[`before`,`changes`,`after`],qe=[[`way`,`trajectory`],[`points`,`points`],[`lines`,`lines`]],Je=class extends URLSearchParams{asked=new Set;get(e){return this.asked.add(e),super.get(e)}};function Ye(e,t=[]){let n=We(),r=new Je(e.replace(/^#/,``)),i=(e,n)=>void t.push(`${e}=${r.get(e)??``} is not ${n}`);function a(e,t,n,a){let o=r.get(e),s=o===null?t:a(o);return s===void 0&&i(e,n),s??t}let o=e=>a(e,null,`a number`,e=>/^\d{1,15}$/.test(e)?Number(e):void 0);n.map=r.get(`map`)??``,n.mode=a(`mode`,r.has(`changeset`)||r.has(`side`)?`drive`:`instant`,`one of ${Ge.join(`, `)}`,e=>Ge.find(t=>t===e)),n.side=a(`side`,`changes`,`one of ${Ke.join(`, `)}`,e=>Ke.find(t=>t===e)),n.changeset=o(`changeset`),n.from=o(`from`)??0,n.to=o(`to`),n.known=o(`known`),n.valid=a(`valid`,null,`a time such as 2026-03-02T12:00:00Z`,e=>Number.isNaN(Date.parse(e))?void 0:new Date(e).toISOString());let s=e=>r.get(e)?.split(`,`)??null,[c,l]=[s(`hide`),s(`show`)];n.hidden=new Set(R.filter(e=>l?!l.includes(e):c?.includes(e))),n.minProbability=a(`p`,0,`a probability`,e=>Number(e)>=0&&Number(e)<=1?Number(e):void 0),n.filter=Oe(r,i),n.inView=r.get(`inview`)===`1`,n.sort=a(`sort`,null,`a column`,e=>/^[a-z]{1,20}-?$/.test(e)?e:void 0),n.list=a(`list`,null,`a list`,e=>/^[a-z]{1,20}$/.test(e)?e:void 0),n.feature=a(`feature`,null,`the id of a cone, 36 characters`,e=>/^[0-9a-f-]{36}$/.test(e)?e:void 0),n.image=a(`image`,null,`a drive and a frame pair`,e=>{let[,t,n]=/^([0-9a-f-]{36})\.(\d{1,9})$/.exec(e)??[];return t&&n?{drive_uuid:t,frame_index:Number(n)}:void 0});for(let[e,t]of qe)n[t]=r.get(e)!==`0`;n.scene=He(r);let u=e=>t=>{let n=t.split(`,`).map(Number);return n.length===e&&n.every(Number.isFinite)?n:void 0};n.mark=a(`mark`,null,`a position`,u(2));let d=a(`cam`,null,`a camera`,u(6));d&&(d[5]??0)>0&&(n.camera=d);for(let e of new Set(r.keys()))r.asked.has(e)||t.push(`${e} is unknown`);return n}function Xe(e){let t=new URLSearchParams;t.set(`map`,e.map),e.mode!==`instant`&&t.set(`mode`,e.mode),e.mode===`drive`&&(e.changeset!==null&&t.set(`changeset`,String(e.changeset)),e.side!==`changes`&&t.set(`side`,e.side)),e.mode===`compare`&&(t.set(`from`,String(e.from)),e.to!==null&&t.set(`to`,String(e.to))),e.mode===`instant`&&e.valid!==null&&t.set(`valid`,e.valid),e.mode!==`drive`&&e.known!==null&&t.set(`known`,String(e.known));let n=R.filter(t=>!e.hidden.has(t));n.length<e.hidden.size?t.set(`show`,n.join(`,`)):e.hidden.size&&t.set(`hide`,[...e.hidden].join(`,`)),e.minProbability>0&&t.set(`p`,String(e.minProbability)),ke(e.filter,t),e.inView&&t.set(`inview`,`1`),e.sort!==null&&t.set(`sort`,e.sort),e.mark&&t.set(`mark`,e.mark.map(e=>e.toFixed(2)).join(`,`)),e.feature&&t.set(`feature`,e.feature),e.feature&&e.image&&t.set(`image`,`${e.image.drive_uuid}.${e.image.frame_index}`);for(let[n,r]of qe)e[r]||t.set(n,`0`);return Ue(t,e.scene,e.mode===`compare`),e.list!==null&&t.set(`list`,e.list),e.camera&&t.set(`cam`,e.camera.map(e=>e.toFixed(3).replace(/\.?0+$/,``)).join(`,`)),t.toString().replaceAll(`%2C`,`,`).replaceAll(`%3A`,`:`)}function Ze(e,t){let n=0,r=-1/0;function i(){window.clearTimeout(n);let t=`#${Xe(e())}`;t!==location.hash&&history.replaceState(null,``,t)}function a(){window.clearTimeout(n),n=window.setTimeout(i,120)}function o(){let e=performance.now();e-r<120?a():i(),r=e}function s(){let e=[],n=Ye(location.hash,e);return e.length&&t(`Part of this link was ignored: ${e.join(`; `)}.`),I?{...n,list:null}:n}return{write:i,writeAtRest:a,writeChoice:o,read:s}}var Qe={LEFT:0,MIDDLE:1,RIGHT:2,ROTATE:0,DOLLY:1,PAN:2},$e={ROTATE:0,PAN:1,DOLLY_PAN:2,DOLLY_ROTATE:3},et=1e3,tt=1001,nt=1002,rt=1003,it=1004,at=1005,ot=1006,st=1007,ct=1008,lt=1009,ut=1010,dt=1011,ft=1012,pt=1013,mt=1014,ht=1015,gt=1016,_t=1017,vt=1018,yt=1020,bt=35902,xt=35899,St=1021,Ct=1022,wt=1023,Tt=1026,Et=1027,Dt=1028,Ot=1029,kt=1030,At=1031,jt=1033,Mt=33776,Nt=33777,Pt=33778,Ft=33779,It=35840,Lt=35841,Rt=35842,zt=35843,Bt=36196,Vt=37492,Ht=37496,Ut=37488,Wt=37489,Gt=37490,Kt=37491,qt=37808,Jt=37809,Yt=37810,Xt=37811,Zt=37812,Qt=37813,$t=37814,en=37815,tn=37816,nn=37817,rn=37818,an=37819,on=37820,sn=37821,cn=36492,ln=36494,un=36495,dn=36283,fn=36284,pn=36285,mn=36286,hn=2300,gn=2301,_n=2302,vn=2303,yn=2400,bn=2401,xn=2402,Sn=3200,Cn=`srgb`,wn=`srgb-linear`,Tn=`linear`,En=`srgb`,Dn=7680,On=35044,kn=35048,An=2e3;function jn(e){for(let t=e.length-1;t>=0;--t)if(e[t]>=65535)return!0;return!1}function Mn(e){return ArrayBuffer.isView(e)&&!(e instanceof DataView)}function Nn(e){return document.createElementNS(`http://www.w3.org/1999/xhtml`,e)}function Pn(){let e=Nn(`canvas`);return e.style.display=`block`,e}var Fn={};function In(...e){let t=`THREE.`+e.shift();console.log(t,...e)}function Ln(e){let t=e[0];if(typeof t==`string`&&t.startsWith(`TSL:`)){let t=e[1];t&&t.isStackTrace?e[0]+=` `+t.getLocation():e[1]=`Stack trace not available. Enable "THREE.Node.captureStackTrace" to capture stack traces.`}return e}function U(...e){e=Ln(e);let t=`THREE.`+e.shift();{let n=e[0];n&&n.isStackTrace?console.warn(n.getError(t)):console.warn(t,...e)}}function W(...e){e=Ln(e);let t=`THREE.`+e.shift();{let n=e[0];n&&n.isStackTrace?console.error(n.getError(t)):console.error(t,...e)}}function Rn(...e){let t=e.join(` `);t in Fn||(Fn[t]=!0,U(...e))}function zn(e,t,n){return new Promise(function(r,i){function a(){switch(e.clientWaitSync(t,e.SYNC_FLUSH_COMMANDS_BIT,0)){case e.WAIT_FAILED:i();break;case e.TIMEOUT_EXPIRED:setTimeout(a,n);break;default:r()}}setTimeout(a,n)})}var Bn={0:0,2:6,4:4,3:5,1:1,6:2,7:7,5:3},Vn=class{addEventListener(e,t){this._listeners===void 0&&(this._listeners={});let n=this._listeners;n[e]===void 0&&(n[e]=[]),n[e].indexOf(t)===-1&&n[e].push(t)}hasEventListener(e,t){let n=this._listeners;return n!==void 0&&n[e]!==void 0&&n[e].indexOf(t)!==-1}removeEventListener(e,t){let n=this._listeners;if(n===void 0)return;let r=n[e];if(r!==void 0){let e=r.indexOf(t);e!==-1&&r.splice(e,1)}}dispatchEvent(e){let t=this._listeners;if(t===void 0)return;let n=t[e.type];if(n!==void 0){e.target=this;let t=n.slice(0);for(let n=0,r=t.length;n<r;n++)t[n].call(this,e);e.target=null}}},Hn=`00.01.02.03.04.05.06.07.08.09.0a.0b.0c.0d.0e.0f.10.11.12.13.14.15.16.17.18.19.1a.1b.1c.1d.1e.1f.20.21.22.23.24.25.26.27.28.29.2a.2b.2c.2d.2e.2f.30.31.32.33.34.35.36.37.38.39.3a.3b.3c.3d.3e.3f.40.41.42.43.44.45.46.47.48.49.4a.4b.4c.4d.4e.4f.50.51.52.53.54.55.56.57.58.59.5a.5b.5c.5d.5e.5f.60.61.62.63.64.65.66.67.68.69.6a.6b.6c.6d.6e.6f.70.71.72.73.74.75.76.77.78.79.7a.7b.7c.7d.7e.7f.80.81.82.83.84.85.86.87.88.89.8a.8b.8c.8d.8e.8f.90.91.92.93.94.95.96.97.98.99.9a.9b.9c.9d.9e.9f.a0.a1.a2.a3.a4.a5.a6.a7.a8.a9.aa.ab.ac.ad.ae.af.b0.b1.b2.b3.b4.b5.b6.b7.b8.b9.ba.bb.bc.bd.be.bf.c0.c1.c2.c3.c4.c5.c6.c7.c8.c9.ca.cb.cc.cd.ce.cf.d0.d1.d2.d3.d4.d5.d6.d7.d8.d9.da.db.dc.dd.de.df.e0.e1.e2.e3.e4.e5.e6.e7.e8.e9.ea.eb.ec.ed.ee.ef.f0.f1.f2.f3.f4.f5.f6.f7.f8.f9.fa.fb.fc.fd.fe.ff`.split(`.`),Un=1234567,Wn=Math.PI/180,Gn=180/Math.PI;function Kn(){let e=Math.random()*4294967295|0,t=Math.random()*4294967295|0,n=Math.random()*4294967295|0,r=Math.random()*4294967295|0;return(Hn[e&255]+Hn[e>>8&255]+Hn[e>>16&255]+Hn[e>>24&255]+`-`+Hn[t&255]+Hn[t>>8&255]+`-`+Hn[t>>16&15|64]+Hn[t>>24&255]+`-`+Hn[n&63|128]+Hn[n>>8&255]+`-`+Hn[n>>16&255]+Hn[n>>24&255]+Hn[r&255]+Hn[r>>8&255]+Hn[r>>16&255]+Hn[r>>24&255]).toLowerCase()}function G(e,t,n){return Math.max(t,Math.min(n,e))}function qn(e,t){return(e%t+t)%t}function Jn(e,t,n,r,i){return r+(e-t)*(i-r)/(n-t)}function Yn(e,t,n){return e===t?0:(n-e)/(t-e)}function Xn(e,t,n){return(1-n)*e+n*t}function Zn(e,t,n,r){return Xn(e,t,1-Math.exp(-n*r))}function Qn(e,t=1){return t-Math.abs(qn(e,t*2)-t)}function $n(e,t,n){return e<=t?0:e>=n?1:(e=(e-t)/(n-t),e*e*(3-2*e))}function er(e,t,n){return e<=t?0:e>=n?1:(e=(e-t)/(n-t),e*e*e*(e*(e*6-15)+10))}function tr(e,t){return e+Math.floor(Math.random()*(t-e+1))}function nr(e,t){return e+Math.random()*(t-e)}function rr(e){return e*(.5-Math.random())}function ir(e){e!==void 0&&(Un=e);let t=Un+=1831565813;return t=Math.imul(t^t>>>15,t|1),t^=t+Math.imul(t^t>>>7,t|61),((t^t>>>14)>>>0)/4294967296}function ar(e){return e*Wn}function or(e){return e*Gn}function sr(e){return e>0&&Number.isInteger(e)&&2**Math.round(Math.log2(e))===e}function cr(e){return 2**Math.ceil(Math.log(e)/Math.LN2)}function lr(e){return 2**Math.floor(Math.log(e)/Math.LN2)}function ur(e,t,n,r,i){let a=Math.cos,o=Math.sin,s=a(n/2),c=o(n/2),l=a((t+r)/2),u=o((t+r)/2),d=a((t-r)/2),f=o((t-r)/2),p=a((r-t)/2),m=o((r-t)/2);switch(i){case`XYX`:e.set(s*u,c*d,c*f,s*l);break;case`YZY`:e.set(c*f,s*u,c*d,s*l);break;case`ZXZ`:e.set(c*d,c*f,s*u,s*l);break;case`XZX`:e.set(s*u,c*m,c*p,s*l);break;case`YXY`:e.set(c*p,s*u,c*m,s*l);break;case`ZYZ`:e.set(c*m,c*p,s*u,s*l);break;default:U(`MathUtils: .setQuaternionFromProperEuler() encountered an unknown order: `+i)}}function dr(e){switch(e.constructor){case Uint32Array:return 4294967295;case Uint16Array:return 65535;case Uint8Array:case Uint8ClampedArray:return 255;case Int32Array:return 2147483647;case Int16Array:return 32767;case Int8Array:return 127;default:return}}function fr(e,t){if(t.constructor===Float32Array)return e;let n=dr(t);if(n===void 0)throw Error(`THREE.MathUtils: Invalid component type.`);return Math.max(e/n,-1)}function pr(e,t){if(t.constructor===Float32Array)return e;let n=dr(t);if(n===void 0)throw Error(`THREE.MathUtils: Invalid component type.`);return Math.round(e*n)}var mr={DEG2RAD:Wn,RAD2DEG:Gn,generateUUID:Kn,clamp:G,euclideanModulo:qn,mapLinear:Jn,inverseLerp:Yn,lerp:Xn,damp:Zn,pingpong:Qn,smoothstep:$n,smootherstep:er,randInt:tr,randFloat:nr,randFloatSpread:rr,seededRandom:ir,degToRad:ar,radToDeg:or,isPowerOfTwo:sr,ceilPowerOfTwo:cr,floorPowerOfTwo:lr,setQuaternionFromProperEuler:ur,normalize:pr,denormalize:fr},K=class{static{this.prototype.isVector2=!0}constructor(e=0,t=0){this.x=e,this.y=t}get width(){return this.x}set width(e){this.x=e}get height(){return this.y}set height(e){this.y=e}set(e,t){return this.x=e,this.y=t,this}setScalar(e){return this.x=e,this.y=e,this}setX(e){return this.x=e,this}setY(e){return this.y=e,this}setComponent(e,t){switch(e){case 0:this.x=t;break;case 1:this.y=t;break;default:throw Error(`THREE.Vector2: index is out of range: `+e)}return this}getComponent(e){switch(e){case 0:return this.x;case 1:return this.y;default:throw Error(`THREE.Vector2: index is out of range: `+e)}}clone(){return new this.constructor(this.x,this.y)}copy(e){return this.x=e.x,this.y=e.y,this}add(e){return this.x+=e.x,this.y+=e.y,this}addScalar(e){return this.x+=e,this.y+=e,this}addVectors(e,t){return this.x=e.x+t.x,this.y=e.y+t.y,this}addScaledVector(e,t){return this.x+=e.x*t,this.y+=e.y*t,this}sub(e){return this.x-=e.x,this.y-=e.y,this}subScalar(e){return this.x-=e,this.y-=e,this}subVectors(e,t){return this.x=e.x-t.x,this.y=e.y-t.y,this}multiply(e){return this.x*=e.x,this.y*=e.y,this}multiplyScalar(e){return this.x*=e,this.y*=e,this}divide(e){return this.x/=e.x,this.y/=e.y,this}divideScalar(e){return this.multiplyScalar(1/e)}applyMatrix3(e){let t=this.x,n=this.y,r=e.elements;return this.x=r[0]*t+r[3]*n+r[6],this.y=r[1]*t+r[4]*n+r[7],this}min(e){return this.x=Math.min(this.x,e.x),this.y=Math.min(this.y,e.y),this}max(e){return this.x=Math.max(this.x,e.x),this.y=Math.max(this.y,e.y),this}clamp(e,t){return this.x=G(this.x,e.x,t.x),this.y=G(this.y,e.y,t.y),this}clampScalar(e,t){return this.x=G(this.x,e,t),this.y=G(this.y,e,t),this}clampLength(e,t){let n=this.length();return this.divideScalar(n||1).multiplyScalar(G(n,e,t))}floor(){return this.x=Math.floor(this.x),this.y=Math.floor(this.y),this}ceil(){return this.x=Math.ceil(this.x),this.y=Math.ceil(this.y),this}round(){return this.x=Math.round(this.x),this.y=Math.round(this.y),this}roundToZero(){return this.x=Math.trunc(this.x),this.y=Math.trunc(this.y),this}negate(){return this.x=-this.x,this.y=-this.y,this}dot(e){return this.x*e.x+this.y*e.y}cross(e){return this.x*e.y-this.y*e.x}lengthSq(){return this.x*this.x+this.y*this.y}length(){return Math.sqrt(this.x*this.x+this.y*this.y)}manhattanLength(){return Math.abs(this.x)+Math.abs(this.y)}normalize(){return this.divideScalar(this.length()||1)}angle(){return Math.atan2(-this.y,-this.x)+Math.PI}angleTo(e){let t=Math.sqrt(this.lengthSq()*e.lengthSq());if(t===0)return Math.PI/2;let n=this.dot(e)/t;return Math.acos(G(n,-1,1))}distanceTo(e){return Math.sqrt(this.distanceToSquared(e))}distanceToSquared(e){let t=this.x-e.x,n=this.y-e.y;return t*t+n*n}manhattanDistanceTo(e){return Math.abs(this.x-e.x)+Math.abs(this.y-e.y)}setLength(e){return this.normalize().multiplyScalar(e)}lerp(e,t){return this.x+=(e.x-this.x)*t,this.y+=(e.y-this.y)*t,this}lerpVectors(e,t,n){return this.x=e.x+(t.x-e.x)*n,this.y=e.y+(t.y-e.y)*n,this}equals(e){return e.x===this.x&&e.y===this.y}fromArray(e,t=0){return this.x=e[t],this.y=e[t+1],this}toArray(e=[],t=0){return e[t]=this.x,e[t+1]=this.y,e}fromBufferAttribute(e,t){return this.x=e.getX(t),this.y=e.getY(t),this}rotateAround(e,t){let n=Math.cos(t),r=Math.sin(t),i=this.x-e.x,a=this.y-e.y;return this.x=i*n-a*r+e.x,this.y=i*r+a*n+e.y,this}random(){return this.x=Math.random(),this.y=Math.random(),this}*[Symbol.iterator](){yield this.x,yield this.y}},hr=class{constructor(e=0,t=0,n=0,r=1){this.isQuaternion=!0,this._x=e,this._y=t,this._z=n,this._w=r}static slerpFlat(e,t,n,r,i,a,o){let s=n[r+0],c=n[r+1],l=n[r+2],u=n[r+3],d=i[a+0],f=i[a+1],p=i[a+2],m=i[a+3];if(u!==m||s!==d||c!==f||l!==p){let e=s*d+c*f+l*p+u*m;e<0&&(d=-d,f=-f,p=-p,m=-m,e=-e);let t=1-o;if(e<.9995){let n=Math.acos(e),r=Math.sin(n);t=Math.sin(t*n)/r,o=Math.sin(o*n)/r,s=s*t+d*o,c=c*t+f*o,l=l*t+p*o,u=u*t+m*o}else{s=s*t+d*o,c=c*t+f*o,l=l*t+p*o,u=u*t+m*o;let e=1/Math.sqrt(s*s+c*c+l*l+u*u);s*=e,c*=e,l*=e,u*=e}}e[t]=s,e[t+1]=c,e[t+2]=l,e[t+3]=u}static multiplyQuaternionsFlat(e,t,n,r,i,a){let o=n[r],s=n[r+1],c=n[r+2],l=n[r+3],u=i[a],d=i[a+1],f=i[a+2],p=i[a+3];return e[t]=o*p+l*u+s*f-c*d,e[t+1]=s*p+l*d+c*u-o*f,e[t+2]=c*p+l*f+o*d-s*u,e[t+3]=l*p-o*u-s*d-c*f,e}get x(){return this._x}set x(e){this._x=e,this._onChangeCallback()}get y(){return this._y}set y(e){this._y=e,this._onChangeCallback()}get z(){return this._z}set z(e){this._z=e,this._onChangeCallback()}get w(){return this._w}set w(e){this._w=e,this._onChangeCallback()}set(e,t,n,r){return this._x=e,this._y=t,this._z=n,this._w=r,this._onChangeCallback(),this}clone(){return new this.constructor(this._x,this._y,this._z,this._w)}copy(e){return this._x=e.x,this._y=e.y,this._z=e.z,this._w=e.w,this._onChangeCallback(),this}setFromEuler(e,t=!0){let n=e._x,r=e._y,i=e._z,a=e._order,o=Math.cos,s=Math.sin,c=o(n/2),l=o(r/2),u=o(i/2),d=s(n/2),f=s(r/2),p=s(i/2);switch(a){case`XYZ`:this._x=d*l*u+c*f*p,this._y=c*f*u-d*l*p,this._z=c*l*p+d*f*u,this._w=c*l*u-d*f*p;break;case`YXZ`:this._x=d*l*u+c*f*p,this._y=c*f*u-d*l*p,this._z=c*l*p-d*f*u,this._w=c*l*u+d*f*p;break;case`ZXY`:this._x=d*l*u-c*f*p,this._y=c*f*u+d*l*p,this._z=c*l*p+d*f*u,this._w=c*l*u-d*f*p;break;case`ZYX`:this._x=d*l*u-c*f*p,this._y=c*f*u+d*l*p,this._z=c*l*p-d*f*u,this._w=c*l*u+d*f*p;break;case`YZX`:this._x=d*l*u+c*f*p,this._y=c*f*u+d*l*p,this._z=c*l*p-d*f*u,this._w=c*l*u-d*f*p;break;case`XZY`:this._x=d*l*u-c*f*p,this._y=c*f*u-d*l*p,this._z=c*l*p+d*f*u,this._w=c*l*u+d*f*p;break;default:U(`Quaternion: .setFromEuler() encountered an unknown order: `+a)}return t===!0&&this._onChangeCallback(),this}setFromAxisAngle(e,t){let n=t/2,r=Math.sin(n);return this._x=e.x*r,this._y=e.y*r,this._z=e.z*r,this._w=Math.cos(n),this._onChangeCallback(),this}setFromRotationMatrix(e){let t=e.elements,n=t[0],r=t[4],i=t[8],a=t[1],o=t[5],s=t[9],c=t[2],l=t[6],u=t[10],d=n+o+u;if(d>0){let e=.5/Math.sqrt(d+1);this._w=.25/e,this._x=(l-s)*e,this._y=(i-c)*e,this._z=(a-r)*e}else if(n>o&&n>u){let e=2*Math.sqrt(1+n-o-u);this._w=(l-s)/e,this._x=.25*e,this._y=(r+a)/e,this._z=(i+c)/e}else if(o>u){let e=2*Math.sqrt(1+o-n-u);this._w=(i-c)/e,this._x=(r+a)/e,this._y=.25*e,this._z=(s+l)/e}else{let e=2*Math.sqrt(1+u-n-o);this._w=(a-r)/e,this._x=(i+c)/e,this._y=(s+l)/e,this._z=.25*e}return this._onChangeCallback(),this}setFromUnitVectors(e,t){let n=e.dot(t)+1;return n<1e-8?(n=0,Math.abs(e.x)>Math.abs(e.z)?(this._x=-e.y,this._y=e.x,this._z=0,this._w=n):(this._x=0,this._y=-e.z,this._z=e.y,this._w=n)):(this._x=e.y*t.z-e.z*t.y,this._y=e.z*t.x-e.x*t.z,this._z=e.x*t.y-e.y*t.x,this._w=n),this.normalize()}angleTo(e){return 2*Math.acos(Math.abs(G(this.dot(e),-1,1)))}rotateTowards(e,t){let n=this.angleTo(e);if(n===0)return this;let r=Math.min(1,t/n);return this.slerp(e,r),this}identity(){return this.set(0,0,0,1)}invert(){return this.conjugate()}conjugate(){return this._x*=-1,this._y*=-1,this._z*=-1,this._onChangeCallback(),this}dot(e){return this._x*e._x+this._y*e._y+this._z*e._z+this._w*e._w}lengthSq(){return this._x*this._x+this._y*this._y+this._z*this._z+this._w*this._w}length(){return Math.sqrt(this._x*this._x+this._y*this._y+this._z*this._z+this._w*this._w)}normalize(){let e=this.length();return e===0?(this._x=0,this._y=0,this._z=0,this._w=1):(e=1/e,this._x*=e,this._y*=e,this._z*=e,this._w*=e),this._onChangeCallback(),this}multiply(e){return this.multiplyQuaternions(this,e)}premultiply(e){return this.multiplyQuaternions(e,this)}multiplyQuaternions(e,t){let n=e._x,r=e._y,i=e._z,a=e._w,o=t._x,s=t._y,c=t._z,l=t._w;return this._x=n*l+a*o+r*c-i*s,this._y=r*l+a*s+i*o-n*c,this._z=i*l+a*c+n*s-r*o,this._w=a*l-n*o-r*s-i*c,this._onChangeCallback(),this}slerp(e,t){let n=e._x,r=e._y,i=e._z,a=e._w,o=this.dot(e);o<0&&(n=-n,r=-r,i=-i,a=-a,o=-o);let s=1-t;if(o<.9995){let e=Math.acos(o),c=Math.sin(e);s=Math.sin(s*e)/c,t=Math.sin(t*e)/c,this._x=this._x*s+n*t,this._y=this._y*s+r*t,this._z=this._z*s+i*t,this._w=this._w*s+a*t,this._onChangeCallback()}else this._x=this._x*s+n*t,this._y=this._y*s+r*t,this._z=this._z*s+i*t,this._w=this._w*s+a*t,this.normalize();return this}slerpQuaternions(e,t,n){return this.copy(e).slerp(t,n)}random(){let e=2*Math.PI*Math.random(),t=2*Math.PI*Math.random(),n=Math.random(),r=Math.sqrt(1-n),i=Math.sqrt(n);return this.set(r*Math.sin(e),r*Math.cos(e),i*Math.sin(t),i*Math.cos(t))}equals(e){return e._x===this._x&&e._y===this._y&&e._z===this._z&&e._w===this._w}fromArray(e,t=0){return this._x=e[t],this._y=e[t+1],this._z=e[t+2],this._w=e[t+3],this._onChangeCallback(),this}toArray(e=[],t=0){return e[t]=this._x,e[t+1]=this._y,e[t+2]=this._z,e[t+3]=this._w,e}fromBufferAttribute(e,t){return this._x=e.getX(t),this._y=e.getY(t),this._z=e.getZ(t),this._w=e.getW(t),this._onChangeCallback(),this}toJSON(){return this.toArray()}_onChange(e){return this._onChangeCallback=e,this}_onChangeCallback(){}*[Symbol.iterator](){yield this._x,yield this._y,yield this._z,yield this._w}},q=class{static{this.prototype.isVector3=!0}constructor(e=0,t=0,n=0){this.x=e,this.y=t,this.z=n}set(e,t,n){return n===void 0&&(n=this.z),this.x=e,this.y=t,this.z=n,this}setScalar(e){return this.x=e,this.y=e,this.z=e,this}setX(e){return this.x=e,this}setY(e){return this.y=e,this}setZ(e){return this.z=e,this}setComponent(e,t){switch(e){case 0:this.x=t;break;case 1:this.y=t;break;case 2:this.z=t;break;default:throw Error(`THREE.Vector3: index is out of range: `+e)}return this}getComponent(e){switch(e){case 0:return this.x;case 1:return this.y;case 2:return this.z;default:throw Error(`THREE.Vector3: index is out of range: `+e)}}clone(){return new this.constructor(this.x,this.y,this.z)}copy(e){return this.x=e.x,this.y=e.y,this.z=e.z,this}add(e){return this.x+=e.x,this.y+=e.y,this.z+=e.z,this}addScalar(e){return this.x+=e,this.y+=e,this.z+=e,this}addVectors(e,t){return this.x=e.x+t.x,this.y=e.y+t.y,this.z=e.z+t.z,this}addScaledVector(e,t){return this.x+=e.x*t,this.y+=e.y*t,this.z+=e.z*t,this}sub(e){return this.x-=e.x,this.y-=e.y,this.z-=e.z,this}subScalar(e){return this.x-=e,this.y-=e,this.z-=e,this}subVectors(e,t){return this.x=e.x-t.x,this.y=e.y-t.y,this.z=e.z-t.z,this}multiply(e){return this.x*=e.x,this.y*=e.y,this.z*=e.z,this}multiplyScalar(e){return this.x*=e,this.y*=e,this.z*=e,this}multiplyVectors(e,t){return this.x=e.x*t.x,this.y=e.y*t.y,this.z=e.z*t.z,this}applyEuler(e){return this.applyQuaternion(_r.setFromEuler(e))}applyAxisAngle(e,t){return this.applyQuaternion(_r.setFromAxisAngle(e,t))}applyMatrix3(e){let t=this.x,n=this.y,r=this.z,i=e.elements;return this.x=i[0]*t+i[3]*n+i[6]*r,this.y=i[1]*t+i[4]*n+i[7]*r,this.z=i[2]*t+i[5]*n+i[8]*r,this}applyNormalMatrix(e){return this.applyMatrix3(e).normalize()}applyMatrix4(e){let t=this.x,n=this.y,r=this.z,i=e.elements,a=1/(i[3]*t+i[7]*n+i[11]*r+i[15]);return this.x=(i[0]*t+i[4]*n+i[8]*r+i[12])*a,this.y=(i[1]*t+i[5]*n+i[9]*r+i[13])*a,this.z=(i[2]*t+i[6]*n+i[10]*r+i[14])*a,this}applyQuaternion(e){let t=this.x,n=this.y,r=this.z,i=e.x,a=e.y,o=e.z,s=e.w,c=2*(a*r-o*n),l=2*(o*t-i*r),u=2*(i*n-a*t);return this.x=t+s*c+a*u-o*l,this.y=n+s*l+o*c-i*u,this.z=r+s*u+i*l-a*c,this}project(e){return this.applyMatrix4(e.matrixWorldInverse).applyMatrix4(e.projectionMatrix)}unproject(e){return this.applyMatrix4(e.projectionMatrixInverse).applyMatrix4(e.matrixWorld)}transformDirection(e){let t=this.x,n=this.y,r=this.z,i=e.elements;return this.x=i[0]*t+i[4]*n+i[8]*r,this.y=i[1]*t+i[5]*n+i[9]*r,this.z=i[2]*t+i[6]*n+i[10]*r,this.normalize()}divide(e){return this.x/=e.x,this.y/=e.y,this.z/=e.z,this}divideScalar(e){return this.multiplyScalar(1/e)}min(e){return this.x=Math.min(this.x,e.x),this.y=Math.min(this.y,e.y),this.z=Math.min(this.z,e.z),this}max(e){return this.x=Math.max(this.x,e.x),this.y=Math.max(this.y,e.y),this.z=Math.max(this.z,e.z),this}clamp(e,t){return this.x=G(this.x,e.x,t.x),this.y=G(this.y,e.y,t.y),this.z=G(this.z,e.z,t.z),this}clampScalar(e,t){return this.x=G(this.x,e,t),this.y=G(this.y,e,t),this.z=G(this.z,e,t),this}clampLength(e,t){let n=this.length();return this.divideScalar(n||1).multiplyScalar(G(n,e,t))}floor(){return this.x=Math.floor(this.x),this.y=Math.floor(this.y),this.z=Math.floor(this.z),this}ceil(){return this.x=Math.ceil(this.x),this.y=Math.ceil(this.y),this.z=Math.ceil(this.z),this}round(){return this.x=Math.round(this.x),this.y=Math.round(this.y),this.z=Math.round(this.z),this}roundToZero(){return this.x=Math.trunc(this.x),this.y=Math.trunc(this.y),this.z=Math.trunc(this.z),this}negate(){return this.x=-this.x,this.y=-this.y,this.z=-this.z,this}dot(e){return this.x*e.x+this.y*e.y+this.z*e.z}lengthSq(){return this.x*this.x+this.y*this.y+this.z*this.z}length(){return Math.sqrt(this.x*this.x+this.y*this.y+this.z*this.z)}manhattanLength(){return Math.abs(this.x)+Math.abs(this.y)+Math.abs(this.z)}normalize(){return this.divideScalar(this.length()||1)}setLength(e){return this.normalize().multiplyScalar(e)}lerp(e,t){return this.x+=(e.x-this.x)*t,this.y+=(e.y-this.y)*t,this.z+=(e.z-this.z)*t,this}lerpVectors(e,t,n){return this.x=e.x+(t.x-e.x)*n,this.y=e.y+(t.y-e.y)*n,this.z=e.z+(t.z-e.z)*n,this}cross(e){return this.crossVectors(this,e)}crossVectors(e,t){let n=e.x,r=e.y,i=e.z,a=t.x,o=t.y,s=t.z;return this.x=r*s-i*o,this.y=i*a-n*s,this.z=n*o-r*a,this}projectOnVector(e){let t=e.lengthSq();if(t===0)return this.set(0,0,0);let n=e.dot(this)/t;return this.copy(e).multiplyScalar(n)}projectOnPlane(e){return gr.copy(this).projectOnVector(e),this.sub(gr)}reflect(e){return this.sub(gr.copy(e).multiplyScalar(2*this.dot(e)))}angleTo(e){let t=Math.sqrt(this.lengthSq()*e.lengthSq());if(t===0)return Math.PI/2;let n=this.dot(e)/t;return Math.acos(G(n,-1,1))}distanceTo(e){return Math.sqrt(this.distanceToSquared(e))}distanceToSquared(e){let t=this.x-e.x,n=this.y-e.y,r=this.z-e.z;return t*t+n*n+r*r}manhattanDistanceTo(e){return Math.abs(this.x-e.x)+Math.abs(this.y-e.y)+Math.abs(this.z-e.z)}setFromSpherical(e){return this.setFromSphericalCoords(e.radius,e.phi,e.theta)}setFromSphericalCoords(e,t,n){let r=Math.sin(t)*e;return this.x=r*Math.sin(n),this.y=Math.cos(t)*e,this.z=r*Math.cos(n),this}setFromCylindrical(e){return this.setFromCylindricalCoords(e.radius,e.theta,e.y)}setFromCylindricalCoords(e,t,n){return this.x=e*Math.sin(t),this.y=n,this.z=e*Math.cos(t),this}setFromMatrixPosition(e){let t=e.elements;return this.x=t[12],this.y=t[13],this.z=t[14],this}setFromMatrixScale(e){let t=this.setFromMatrixColumn(e,0).length(),n=this.setFromMatrixColumn(e,1).length(),r=this.setFromMatrixColumn(e,2).length();return this.x=t,this.y=n,this.z=r,this}setFromMatrixColumn(e,t){return this.fromArray(e.elements,t*4)}setFromMatrix3Column(e,t){return this.fromArray(e.elements,t*3)}setFromEuler(e){return this.x=e._x,this.y=e._y,this.z=e._z,this}setFromColor(e){return this.x=e.r,this.y=e.g,this.z=e.b,this}equals(e){return e.x===this.x&&e.y===this.y&&e.z===this.z}fromArray(e,t=0){return this.x=e[t],this.y=e[t+1],this.z=e[t+2],this}toArray(e=[],t=0){return e[t]=this.x,e[t+1]=this.y,e[t+2]=this.z,e}fromBufferAttribute(e,t){return this.x=e.getX(t),this.y=e.getY(t),this.z=e.getZ(t),this}random(){return this.x=Math.random(),this.y=Math.random(),this.z=Math.random(),this}randomDirection(){let e=Math.random()*Math.PI*2,t=Math.random()*2-1,n=Math.sqrt(1-t*t);return this.x=n*Math.cos(e),this.y=t,this.z=n*Math.sin(e),this}*[Symbol.iterator](){yield this.x,yield this.y,yield this.z}},gr=new q,_r=new hr,J=class{static{this.prototype.isMatrix3=!0}constructor(e,t,n,r,i,a,o,s,c){this.elements=[1,0,0,0,1,0,0,0,1],e!==void 0&&this.set(e,t,n,r,i,a,o,s,c)}set(e,t,n,r,i,a,o,s,c){let l=this.elements;return l[0]=e,l[1]=r,l[2]=o,l[3]=t,l[4]=i,l[5]=s,l[6]=n,l[7]=a,l[8]=c,this}identity(){return this.set(1,0,0,0,1,0,0,0,1),this}copy(e){let t=this.elements,n=e.elements;return t[0]=n[0],t[1]=n[1],t[2]=n[2],t[3]=n[3],t[4]=n[4],t[5]=n[5],t[6]=n[6],t[7]=n[7],t[8]=n[8],this}extractBasis(e,t,n){return e.setFromMatrix3Column(this,0),t.setFromMatrix3Column(this,1),n.setFromMatrix3Column(this,2),this}setFromMatrix4(e){let t=e.elements;return this.set(t[0],t[4],t[8],t[1],t[5],t[9],t[2],t[6],t[10]),this}multiply(e){return this.multiplyMatrices(this,e)}premultiply(e){return this.multiplyMatrices(e,this)}multiplyMatrices(e,t){let n=e.elements,r=t.elements,i=this.elements,a=n[0],o=n[3],s=n[6],c=n[1],l=n[4],u=n[7],d=n[2],f=n[5],p=n[8],m=r[0],h=r[3],g=r[6],_=r[1],v=r[4],y=r[7],b=r[2],x=r[5],S=r[8];return i[0]=a*m+o*_+s*b,i[3]=a*h+o*v+s*x,i[6]=a*g+o*y+s*S,i[1]=c*m+l*_+u*b,i[4]=c*h+l*v+u*x,i[7]=c*g+l*y+u*S,i[2]=d*m+f*_+p*b,i[5]=d*h+f*v+p*x,i[8]=d*g+f*y+p*S,this}multiplyScalar(e){let t=this.elements;return t[0]*=e,t[3]*=e,t[6]*=e,t[1]*=e,t[4]*=e,t[7]*=e,t[2]*=e,t[5]*=e,t[8]*=e,this}determinant(){let e=this.elements,t=e[0],n=e[1],r=e[2],i=e[3],a=e[4],o=e[5],s=e[6],c=e[7],l=e[8];return t*a*l-t*o*c-n*i*l+n*o*s+r*i*c-r*a*s}invert(){let e=this.elements,t=e[0],n=e[1],r=e[2],i=e[3],a=e[4],o=e[5],s=e[6],c=e[7],l=e[8],u=l*a-o*c,d=o*s-l*i,f=c*i-a*s,p=t*u+n*d+r*f;if(p===0)return this.set(0,0,0,0,0,0,0,0,0);let m=1/p;return e[0]=u*m,e[1]=(r*c-l*n)*m,e[2]=(o*n-r*a)*m,e[3]=d*m,e[4]=(l*t-r*s)*m,e[5]=(r*i-o*t)*m,e[6]=f*m,e[7]=(n*s-c*t)*m,e[8]=(a*t-n*i)*m,this}transpose(){let e,t=this.elements;return e=t[1],t[1]=t[3],t[3]=e,e=t[2],t[2]=t[6],t[6]=e,e=t[5],t[5]=t[7],t[7]=e,this}getNormalMatrix(e){return this.setFromMatrix4(e).invert().transpose()}transposeIntoArray(e){let t=this.elements;return e[0]=t[0],e[1]=t[3],e[2]=t[6],e[3]=t[1],e[4]=t[4],e[5]=t[7],e[6]=t[2],e[7]=t[5],e[8]=t[8],this}setUvTransform(e,t,n,r,i,a,o){let s=Math.cos(i),c=Math.sin(i);return this.set(n*s,n*c,-n*(s*a+c*o)+a+e,-r*c,r*s,-r*(-c*a+s*o)+o+t,0,0,1),this}scale(e,t){return Rn(`Matrix3: .scale() is deprecated. Use .makeScale() instead.`),this.premultiply(vr.makeScale(e,t)),this}rotate(e){return Rn(`Matrix3: .rotate() is deprecated. Use .makeRotation() instead.`),this.premultiply(vr.makeRotation(-e)),this}translate(e,t){return Rn(`Matrix3: .translate() is deprecated. Use .makeTranslation() instead.`),this.premultiply(vr.makeTranslation(e,t)),this}makeTranslation(e,t){return e.isVector2?this.set(1,0,e.x,0,1,e.y,0,0,1):this.set(1,0,e,0,1,t,0,0,1),this}makeRotation(e){let t=Math.cos(e),n=Math.sin(e);return this.set(t,-n,0,n,t,0,0,0,1),this}makeScale(e,t){return this.set(e,0,0,0,t,0,0,0,1),this}equals(e){let t=this.elements,n=e.elements;for(let e=0;e<9;e++)if(t[e]!==n[e])return!1;return!0}fromArray(e,t=0){for(let n=0;n<9;n++)this.elements[n]=e[n+t];return this}toArray(e=[],t=0){let n=this.elements;return e[t]=n[0],e[t+1]=n[1],e[t+2]=n[2],e[t+3]=n[3],e[t+4]=n[4],e[t+5]=n[5],e[t+6]=n[6],e[t+7]=n[7],e[t+8]=n[8],e}clone(){return new this.constructor().fromArray(this.elements)}},vr=new J,yr=new J().set(.4123908,.3575843,.1804808,.212639,.7151687,.0721923,.0193308,.1191948,.9505322),br=new J().set(3.2409699,-1.5373832,-.4986108,-.9692436,1.8759675,.0415551,.0556301,-.203977,1.0569715);function xr(){let e={enabled:!0,workingColorSpace:wn,spaces:{},convert:function(e,t,n){return this.enabled===!1||t===n||!t||!n||(this.spaces[t].transfer===`srgb`&&(e.r=Cr(e.r),e.g=Cr(e.g),e.b=Cr(e.b)),this.spaces[t].primaries!==this.spaces[n].primaries&&(e.applyMatrix3(this.spaces[t].toXYZ),e.applyMatrix3(this.spaces[n].fromXYZ)),this.spaces[n].transfer===`srgb`&&(e.r=wr(e.r),e.g=wr(e.g),e.b=wr(e.b))),e},workingToColorSpace:function(e,t){return this.convert(e,this.workingColorSpace,t)},colorSpaceToWorking:function(e,t){return this.convert(e,t,this.workingColorSpace)},getPrimaries:function(e){return this.spaces[e].primaries},getTransfer:function(e){return e===``?Tn:this.spaces[e].transfer},getToneMappingMode:function(e){return this.spaces[e].outputColorSpaceConfig.toneMappingMode||`standard`},getLuminanceCoefficients:function(e,t=this.workingColorSpace){return e.fromArray(this.spaces[t].luminanceCoefficients)},define:function(e){Object.assign(this.spaces,e)},_getMatrix:function(e,t,n){return e.copy(this.spaces[n].fromXYZ).multiply(this.spaces[t].toXYZ)},_getDrawingBufferColorSpace:function(e){return this.spaces[e].outputColorSpaceConfig.drawingBufferColorSpace},_getUnpackColorSpace:function(e=this.workingColorSpace){return this.spaces[e].workingColorSpaceConfig.unpackColorSpace}},t=[.64,.33,.3,.6,.15,.06],n=[.2126,.7152,.0722],r=[.3127,.329];return e.define({[wn]:{primaries:t,whitePoint:r,transfer:Tn,toXYZ:yr,fromXYZ:br,luminanceCoefficients:n,workingColorSpaceConfig:{unpackColorSpace:Cn},outputColorSpaceConfig:{drawingBufferColorSpace:Cn}},[Cn]:{primaries:t,whitePoint:r,transfer:En,toXYZ:yr,fromXYZ:br,luminanceCoefficients:n,outputColorSpaceConfig:{drawingBufferColorSpace:Cn}}}),e}var Sr=xr();function Cr(e){return e<.04045?e*.0773993808:(e*.9478672986+.0521327014)**2.4}function wr(e){return e<.0031308?e*12.92:1.055*e**.41666-.055}var Tr,Er=class{static getDataURL(e,t=`image/png`){if(/^data:/i.test(e.src)||typeof HTMLCanvasElement>`u`)return e.src;let n;if(e instanceof HTMLCanvasElement)n=e;else{Tr===void 0&&(Tr=Nn(`canvas`)),Tr.width=e.width,Tr.height=e.height;let t=Tr.getContext(`2d`);e instanceof ImageData?t.putImageData(e,0,0):t.drawImage(e,0,0,e.width,e.height),n=Tr}return n.toDataURL(t)}static sRGBToLinear(e){if(typeof HTMLImageElement<`u`&&e instanceof HTMLImageElement||typeof HTMLCanvasElement<`u`&&e instanceof HTMLCanvasElement||typeof ImageBitmap<`u`&&e instanceof ImageBitmap){let t=Nn(`canvas`);t.width=e.width,t.height=e.height;let n=t.getContext(`2d`);n.drawImage(e,0,0,e.width,e.height);let r=n.getImageData(0,0,e.width,e.height),i=r.data;for(let e=0;e<i.length;e++)i[e]=Cr(i[e]/255)*255;return n.putImageData(r,0,0),t}if(e.data){let t=e.data.slice(0);for(let e=0;e<t.length;e++)t instanceof Uint8Array||t instanceof Uint8ClampedArray?t[e]=Math.floor(Cr(t[e]/255)*255):t[e]=Cr(t[e]);return{data:t,width:e.width,height:e.height}}return U(`ImageUtils.sRGBToLinear(): Unsupported image type. No color space conversion applied.`),e}},Dr=0,Or=class{constructor(e=null){this.isTextureSource=!0,Object.defineProperty(this,"id",{value:Dr++}),this.uuid=Kn(),this.data=e,this.dataReady=!0,this.version=0}getSize(e){let t=this.data;return typeof HTMLVideoElement<`u`&&t instanceof HTMLVideoElement?e.set(t.videoWidth,t.videoHeight,0):typeof VideoFrame<`u`&&t instanceof VideoFrame?e.set(t.displayWidth,t.displayHeight,0):t===null?e.set(0,0,0):e.set(t.width||0,t.height||0,t.depth||0),e}set needsUpdate(e){e===!0&&this.version++}toJSON(e){let t=e===void 0||typeof e==`string`;if(!t&&e.images[this.uuid]!==void 0)return e.images[this.uuid];let n={uuid:this.uuid,url:``},r=this.data;if(r!==null){let e;if(Array.isArray(r)){e=[];for(let t=0,n=r.length;t<n;t++)r[t].isDataTexture?e.push(kr(r[t].image)):e.push(kr(r[t]))}else e=kr(r);n.url=e}return t||(e.images[this.uuid]=n),n}};function kr(e){return typeof HTMLImageElement<`u`&&e instanceof HTMLImageElement||typeof HTMLCanvasElement<`u`&&e instanceof HTMLCanvasElement||typeof ImageBitmap<`u`&&e instanceof ImageBitmap?Er.getDataURL(e):e.data?{data:Array.from(e.data),width:e.width,height:e.height,type:e.data.constructor.name}:(U(`Texture: Unable to serialize Texture.`),{})}var Ar=0,jr=new q,Mr=class e extends Vn{constructor(t=e.DEFAULT_IMAGE,n=e.DEFAULT_MAPPING,r=tt,i=tt,a=ot,o=ct,s=wt,c=lt,l=e.DEFAULT_ANISOTROPY,u=``){super(),this.isTexture=!0,Object.defineProperty(this,"id",{value:Ar++}),this.uuid=Kn(),this.name=``,this.source=new Or(t),this.mipmaps=[],this.mapping=n,this.channel=0,this.wrapS=r,this.wrapT=i,this.magFilter=a,this.minFilter=o,this.anisotropy=l,this.format=s,this.internalFormat=null,this.type=c,this.offset=new K(0,0),this.repeat=new K(1,1),this.center=new K(0,0),this.rotation=0,this.matrixAutoUpdate=!0,this.matrix=new J,this.generateMipmaps=!0,this.mipmapsAutoUpdate=!0,this.premultiplyAlpha=!1,this.flipY=!0,this.unpackAlignment=4,this.colorSpace=u,this.userData={},this.updateRanges=[],this.version=0,this.onUpdate=null,this.renderTarget=null,this.isRenderTargetTexture=!1,this.isArrayTexture=!!(t&&t.depth&&t.depth>1),this.pmremVersion=0,this.isPMREMTexture=!1,this.normalized=!1}get width(){return this.source.getSize(jr).x}get height(){return this.source.getSize(jr).y}get depth(){return this.source.getSize(jr).z}get image(){return this.source.data}set image(e){this.source.data=e}updateMatrix(){this.matrix.setUvTransform(this.offset.x,this.offset.y,this.repeat.x,this.repeat.y,this.rotation,this.center.x,this.center.y)}addUpdateRange(e,t){this.updateRanges.push({start:e,count:t})}clearUpdateRanges(){this.updateRanges.length=0}clone(){return new this.constructor().copy(this)}copy(e){return this.name=e.name,this.source=e.source,this.mipmaps=e.mipmaps.slice(0),this.mapping=e.mapping,this.channel=e.channel,this.wrapS=e.wrapS,this.wrapT=e.wrapT,this.magFilter=e.magFilter,this.minFilter=e.minFilter,this.anisotropy=e.anisotropy,this.format=e.format,this.internalFormat=e.internalFormat,this.type=e.type,this.normalized=e.normalized,this.offset.copy(e.offset),this.repeat.copy(e.repeat),this.center.copy(e.center),this.rotation=e.rotation,this.matrixAutoUpdate=e.matrixAutoUpdate,this.matrix.copy(e.matrix),this.generateMipmaps=e.generateMipmaps,this.mipmapsAutoUpdate=e.mipmapsAutoUpdate,this.premultiplyAlpha=e.premultiplyAlpha,this.flipY=e.flipY,this.unpackAlignment=e.unpackAlignment,this.colorSpace=e.colorSpace,this.renderTarget=e.renderTarget,this.isRenderTargetTexture=e.isRenderTargetTexture,this.isPMREMTexture=e.isPMREMTexture,this.isArrayTexture=e.isArrayTexture,this.userData=JSON.parse(JSON.stringify(e.userData)),this.needsUpdate=!0,this}setValues(e){for(let t in e){let n=e[t];if(n===void 0){U(`Texture.setValues(): parameter '${t}' has value of undefined.`);continue}let r=this[t];r===void 0?U(`Texture.setValues(): property '${t}' does not exist.`):r&&n&&r.isVector2&&n.isVector2||r&&n&&r.isVector3&&n.isVector3||r&&n&&r.isMatrix3&&n.isMatrix3?r.copy(n):this[t]=n}}toJSON(e){let t=e===void 0||typeof e==`string`;if(!t&&e.textures[this.uuid]!==void 0)return e.textures[this.uuid];let n={metadata:{version:4.7,type:`Texture`,generator:`Texture.toJSON`},uuid:this.uuid,name:this.name,image:this.source.toJSON(e).uuid,mapping:this.mapping,channel:this.channel,repeat:[this.repeat.x,this.repeat.y],offset:[this.offset.x,this.offset.y],center:[this.center.x,this.center.y],rotation:this.rotation,wrap:[this.wrapS,this.wrapT],format:this.format,internalFormat:this.internalFormat,type:this.type,normalized:this.normalized,colorSpace:this.colorSpace,minFilter:this.minFilter,magFilter:this.magFilter,anisotropy:this.anisotropy,flipY:this.flipY,generateMipmaps:this.generateMipmaps,mipmapsAutoUpdate:this.mipmapsAutoUpdate,premultiplyAlpha:this.premultiplyAlpha,unpackAlignment:this.unpackAlignment};return Object.keys(this.userData).length>0&&(n.userData=this.userData),t||(e.textures[this.uuid]=n),n}dispose(){this.dispatchEvent({type:`dispose`})}transformUv(e){if(this.mapping!==300)return e;if(e.applyMatrix3(this.matrix),e.x<0||e.x>1)switch(this.wrapS){case et:e.x-=Math.floor(e.x);break;case tt:e.x=e.x<0?0:1;break;case nt:Math.abs(Math.floor(e.x)%2)===1?e.x=Math.ceil(e.x)-e.x:e.x-=Math.floor(e.x)}if(e.y<0||e.y>1)switch(this.wrapT){case et:e.y-=Math.floor(e.y);break;case tt:e.y=e.y<0?0:1;break;case nt:Math.abs(Math.floor(e.y)%2)===1?e.y=Math.ceil(e.y)-e.y:e.y-=Math.floor(e.y)}return this.flipY&&(e.y=1-e.y),e}set needsUpdate(e){e===!0&&(this.version++,this.source.needsUpdate=!0)}set needsPMREMUpdate(e){e===!0&&this.pmremVersion++}};Mr.DEFAULT_IMAGE=null,Mr.DEFAULT_MAPPING=300,Mr.DEFAULT_ANISOTROPY=1;var Nr=class{static{this.prototype.isVector4=!0}constructor(e=0,t=0,n=0,r=1){this.x=e,this.y=t,this.z=n,this.w=r}get width(){return this.z}set width(e){this.z=e}get height(){return this.w}set height(e){this.w=e}set(e,t,n,r){return this.x=e,this.y=t,this.z=n,this.w=r,this}setScalar(e){return this.x=e,this.y=e,this.z=e,this.w=e,this}setX(e){return this.x=e,this}setY(e){return this.y=e,this}setZ(e){return this.z=e,this}setW(e){return this.w=e,this}setComponent(e,t){switch(e){case 0:this.x=t;break;case 1:this.y=t;break;case 2:this.z=t;break;case 3:this.w=t;break;default:throw Error(`THREE.Vector4: index is out of range: `+e)}return this}getComponent(e){switch(e){case 0:return this.x;case 1:return this.y;case 2:return this.z;case 3:return this.w;default:throw Error(`THREE.Vector4: index is out of range: `+e)}}clone(){return new this.constructor(this.x,this.y,this.z,this.w)}copy(e){return this.x=e.x,this.y=e.y,this.z=e.z,this.w=e.w===void 0?1:e.w,this}add(e){return this.x+=e.x,this.y+=e.y,this.z+=e.z,this.w+=e.w,this}addScalar(e){return this.x+=e,this.y+=e,this.z+=e,this.w+=e,this}addVectors(e,t){return this.x=e.x+t.x,this.y=e.y+t.y,this.z=e.z+t.z,this.w=e.w+t.w,this}addScaledVector(e,t){return this.x+=e.x*t,this.y+=e.y*t,this.z+=e.z*t,this.w+=e.w*t,this}sub(e){return this.x-=e.x,this.y-=e.y,this.z-=e.z,this.w-=e.w,this}subScalar(e){return this.x-=e,this.y-=e,this.z-=e,this.w-=e,this}subVectors(e,t){return this.x=e.x-t.x,this.y=e.y-t.y,this.z=e.z-t.z,this.w=e.w-t.w,this}multiply(e){return this.x*=e.x,this.y*=e.y,this.z*=e.z,this.w*=e.w,this}multiplyScalar(e){return this.x*=e,this.y*=e,this.z*=e,this.w*=e,this}applyMatrix4(e){let t=this.x,n=this.y,r=this.z,i=this.w,a=e.elements;return this.x=a[0]*t+a[4]*n+a[8]*r+a[12]*i,this.y=a[1]*t+a[5]*n+a[9]*r+a[13]*i,this.z=a[2]*t+a[6]*n+a[10]*r+a[14]*i,this.w=a[3]*t+a[7]*n+a[11]*r+a[15]*i,this}divide(e){return this.x/=e.x,this.y/=e.y,this.z/=e.z,this.w/=e.w,this}divideScalar(e){return this.multiplyScalar(1/e)}setAxisAngleFromQuaternion(e){this.w=2*Math.acos(e.w);let t=Math.sqrt(1-e.w*e.w);return t<1e-4?(this.x=1,this.y=0,this.z=0):(this.x=e.x/t,this.y=e.y/t,this.z=e.z/t),this}setAxisAngleFromRotationMatrix(e){let t,n,r,i,a=.01,o=.1,s=e.elements,c=s[0],l=s[4],u=s[8],d=s[1],f=s[5],p=s[9],m=s[2],h=s[6],g=s[10];if(Math.abs(l-d)<a&&Math.abs(u-m)<a&&Math.abs(p-h)<a){if(Math.abs(l+d)<o&&Math.abs(u+m)<o&&Math.abs(p+h)<o&&Math.abs(c+f+g-3)<o)return this.set(1,0,0,0),this;t=Math.PI;let e=(c+1)/2,s=(f+1)/2,_=(g+1)/2,v=(l+d)/4,y=(u+m)/4,b=(p+h)/4;return e>s&&e>_?e<a?(n=0,r=.707106781,i=.707106781):(n=Math.sqrt(e),r=v/n,i=y/n):s>_?s<a?(n=.707106781,r=0,i=.707106781):(r=Math.sqrt(s),n=v/r,i=b/r):_<a?(n=.707106781,r=.707106781,i=0):(i=Math.sqrt(_),n=y/i,r=b/i),this.set(n,r,i,t),this}let _=Math.sqrt((h-p)*(h-p)+(u-m)*(u-m)+(d-l)*(d-l));return Math.abs(_)<.001&&(_=1),this.x=(h-p)/_,this.y=(u-m)/_,this.z=(d-l)/_,this.w=Math.acos((c+f+g-1)/2),this}setFromMatrixPosition(e){let t=e.elements;return this.x=t[12],this.y=t[13],this.z=t[14],this.w=t[15],this}min(e){return this.x=Math.min(this.x,e.x),this.y=Math.min(this.y,e.y),this.z=Math.min(this.z,e.z),this.w=Math.min(this.w,e.w),this}max(e){return this.x=Math.max(this.x,e.x),this.y=Math.max(this.y,e.y),this.z=Math.max(this.z,e.z),this.w=Math.max(this.w,e.w),this}clamp(e,t){return this.x=G(this.x,e.x,t.x),this.y=G(this.y,e.y,t.y),this.z=G(this.z,e.z,t.z),this.w=G(this.w,e.w,t.w),this}clampScalar(e,t){return this.x=G(this.x,e,t),this.y=G(this.y,e,t),this.z=G(this.z,e,t),this.w=G(this.w,e,t),this}clampLength(e,t){let n=this.length();return this.divideScalar(n||1).multiplyScalar(G(n,e,t))}floor(){return this.x=Math.floor(this.x),this.y=Math.floor(this.y),this.z=Math.floor(this.z),this.w=Math.floor(this.w),this}ceil(){return this.x=Math.ceil(this.x),this.y=Math.ceil(this.y),this.z=Math.ceil(this.z),this.w=Math.ceil(this.w),this}round(){return this.x=Math.round(this.x),this.y=Math.round(this.y),this.z=Math.round(this.z),this.w=Math.round(this.w),this}roundToZero(){return this.x=Math.trunc(this.x),this.y=Math.trunc(this.y),this.z=Math.trunc(this.z),this.w=Math.trunc(this.w),this}negate(){return this.x=-this.x,this.y=-this.y,this.z=-this.z,this.w=-this.w,this}dot(e){return this.x*e.x+this.y*e.y+this.z*e.z+this.w*e.w}lengthSq(){return this.x*this.x+this.y*this.y+this.z*this.z+this.w*this.w}length(){return Math.sqrt(this.x*this.x+this.y*this.y+this.z*this.z+this.w*this.w)}manhattanLength(){return Math.abs(this.x)+Math.abs(this.y)+Math.abs(this.z)+Math.abs(this.w)}normalize(){return this.divideScalar(this.length()||1)}setLength(e){return this.normalize().multiplyScalar(e)}lerp(e,t){return this.x+=(e.x-this.x)*t,this.y+=(e.y-this.y)*t,this.z+=(e.z-this.z)*t,this.w+=(e.w-this.w)*t,this}lerpVectors(e,t,n){return this.x=e.x+(t.x-e.x)*n,this.y=e.y+(t.y-e.y)*n,this.z=e.z+(t.z-e.z)*n,this.w=e.w+(t.w-e.w)*n,this}equals(e){return e.x===this.x&&e.y===this.y&&e.z===this.z&&e.w===this.w}fromArray(e,t=0){return this.x=e[t],this.y=e[t+1],this.z=e[t+2],this.w=e[t+3],this}toArray(e=[],t=0){return e[t]=this.x,e[t+1]=this.y,e[t+2]=this.z,e[t+3]=this.w,e}fromBufferAttribute(e,t){return this.x=e.getX(t),this.y=e.getY(t),this.z=e.getZ(t),this.w=e.getW(t),this}random(){return this.x=Math.random(),this.y=Math.random(),this.z=Math.random(),this.w=Math.random(),this}*[Symbol.iterator](){yield this.x,yield this.y,yield this.z,yield this.w}},Pr=class extends Vn{constructor(e=1,t=1,n={}){super(),n=Object.assign({generateMipmaps:!1,internalFormat:null,minFilter:ot,depthBuffer:!0,stencilBuffer:!1,resolveColorBuffer:!0,resolveDepthBuffer:!0,resolveStencilBuffer:!0,storeMultisampledColorBuffer:!0,storeMultisampledDepthBuffer:!0,storeMultisampledStencilBuffer:!0,depthTexture:null,samples:0,count:1,depth:1,multiview:!1,useArrayDepthTexture:!1},n),this.isRenderTarget=!0,this.width=e,this.height=t,this.depth=n.depth,this.scissor=new Nr(0,0,e,t),this.scissorTest=!1,this.viewport=new Nr(0,0,e,t),this.textures=[];let r=n.count;for(let i=0;i<r;i++)this.textures[i]=new Mr({width:e,height:t,depth:n.depth}),this.textures[i].isRenderTargetTexture=!0,this.textures[i].renderTarget=this;this._setTextureOptions(n),this.depthBuffer=n.depthBuffer,this.stencilBuffer=n.stencilBuffer,this.resolveColorBuffer=n.resolveColorBuffer,this.resolveDepthBuffer=n.resolveDepthBuffer,this.resolveStencilBuffer=n.resolveStencilBuffer,this.storeMultisampledColorBuffer=n.storeMultisampledColorBuffer,this.storeMultisampledDepthBuffer=n.storeMultisampledDepthBuffer,this.storeMultisampledStencilBuffer=n.storeMultisampledStencilBuffer,this._depthTexture=null,this.depthTexture=n.depthTexture,this.samples=n.samples,this.multiview=n.multiview,this.useArrayDepthTexture=n.useArrayDepthTexture}_setTextureOptions(e={}){let t={minFilter:ot,generateMipmaps:!1,flipY:!1,internalFormat:null};e.mapping!==void 0&&(t.mapping=e.mapping),e.wrapS!==void 0&&(t.wrapS=e.wrapS),e.wrapT!==void 0&&(t.wrapT=e.wrapT),e.wrapR!==void 0&&(t.wrapR=e.wrapR),e.magFilter!==void 0&&(t.magFilter=e.magFilter),e.minFilter!==void 0&&(t.minFilter=e.minFilter),e.format!==void 0&&(t.format=e.format),e.type!==void 0&&(t.type=e.type),e.anisotropy!==void 0&&(t.anisotropy=e.anisotropy),e.colorSpace!==void 0&&(t.colorSpace=e.colorSpace),e.flipY!==void 0&&(t.flipY=e.flipY),e.generateMipmaps!==void 0&&(t.generateMipmaps=e.generateMipmaps),e.mipmapsAutoUpdate!==void 0&&(t.mipmapsAutoUpdate=e.mipmapsAutoUpdate),e.internalFormat!==void 0&&(t.internalFormat=e.internalFormat);for(let e=0;e<this.textures.length;e++)this.textures[e].setValues(t)}get texture(){return this.textures[0]}set texture(e){this.textures[0]=e}set depthTexture(e){this._depthTexture!==null&&this._depthTexture.renderTarget===this&&(this._depthTexture.renderTarget=null),e!==null&&e.renderTarget===null&&(e.renderTarget=this),this._depthTexture=e}get depthTexture(){return this._depthTexture}setSize(e,t,n=1){if(this.width!==e||this.height!==t||this.depth!==n){this.width=e,this.height=t,this.depth=n;for(let r=0,i=this.textures.length;r<i;r++)this.textures[r].image.width=e,this.textures[r].image.height=t,this.textures[r].image.depth=n,this.textures[r].isData3DTexture!==!0&&(this.textures[r].isArrayTexture=this.textures[r].image.depth>1);this.dispose()}this.viewport.set(0,0,e,t),this.scissor.set(0,0,e,t)}clone(){return new this.constructor().copy(this)}copy(e){this.width=e.width,this.height=e.height,this.depth=e.depth,this.scissor.copy(e.scissor),this.scissorTest=e.scissorTest,this.viewport.copy(e.viewport),this.textures.length=0;for(let t=0,n=e.textures.length;t<n;t++){this.textures[t]=e.textures[t].clone(),this.textures[t].isRenderTargetTexture=!0,this.textures[t].renderTarget=this;let n=Object.assign({},e.textures[t].image);this.textures[t].source=new Or(n)}if(this.depthBuffer=e.depthBuffer,this.stencilBuffer=e.stencilBuffer,this.resolveColorBuffer=e.resolveColorBuffer,this.resolveDepthBuffer=e.resolveDepthBuffer,this.resolveStencilBuffer=e.resolveStencilBuffer,this.storeMultisampledColorBuffer=e.storeMultisampledColorBuffer,this.storeMultisampledDepthBuffer=e.storeMultisampledDepthBuffer,this.storeMultisampledStencilBuffer=e.storeMultisampledStencilBuffer,e.depthTexture!==null){if(e.depthTexture.renderTarget===e){let t=e.depthTexture.clone();t.renderTarget=null,this.depthTexture=t}else this.depthTexture=e.depthTexture}else this.depthTexture=null;return this.samples=e.samples,this.multiview=e.multiview,this.useArrayDepthTexture=e.useArrayDepthTexture,this}dispose(){this.dispatchEvent({type:`dispose`})}},Fr=class extends Pr{constructor(e=1,t=1,n={}){super(e,t,n),this.isWebGLRenderTarget=!0}},Ir=class extends Mr{constructor(e=null,t=1,n=1,r=1){super(null),this.isDataArrayTexture=!0,this.image={data:e,width:t,height:n,depth:r},this.magFilter=rt,this.minFilter=rt,this.wrapR=tt,this.generateMipmaps=!1,this.flipY=!1,this.unpackAlignment=1,this.layerUpdates=new Set}copy(e){return super.copy(e),this.wrapR=e.wrapR,this}addLayerUpdate(e){this.layerUpdates.add(e)}clearLayerUpdates(){this.layerUpdates.clear()}},Lr=class extends Mr{constructor(e=null,t=1,n=1,r=1){super(null),this.isData3DTexture=!0,this.image={data:e,width:t,height:n,depth:r},this.magFilter=rt,this.minFilter=rt,this.wrapR=tt,this.generateMipmaps=!1,this.flipY=!1,this.unpackAlignment=1}copy(e){return super.copy(e),this.wrapR=e.wrapR,this}},Rr=class e{static{this.prototype.isMatrix4=!0}constructor(e,t,n,r,i,a,o,s,c,l,u,d,f,p,m,h){this.elements=[1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1],e!==void 0&&this.set(e,t,n,r,i,a,o,s,c,l,u,d,f,p,m,h)}set(e,t,n,r,i,a,o,s,c,l,u,d,f,p,m,h){let g=this.elements;return g[0]=e,g[4]=t,g[8]=n,g[12]=r,g[1]=i,g[5]=a,g[9]=o,g[13]=s,g[2]=c,g[6]=l,g[10]=u,g[14]=d,g[3]=f,g[7]=p,g[11]=m,g[15]=h,this}identity(){return this.set(1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1),this}clone(){return new e().fromArray(this.elements)}copy(e){let t=this.elements,n=e.elements;return t[0]=n[0],t[1]=n[1],t[2]=n[2],t[3]=n[3],t[4]=n[4],t[5]=n[5],t[6]=n[6],t[7]=n[7],t[8]=n[8],t[9]=n[9],t[10]=n[10],t[11]=n[11],t[12]=n[12],t[13]=n[13],t[14]=n[14],t[15]=n[15],this}copyPosition(e){let t=this.elements,n=e.elements;return t[12]=n[12],t[13]=n[13],t[14]=n[14],this}setFromMatrix3(e){let t=e.elements;return this.set(t[0],t[3],t[6],0,t[1],t[4],t[7],0,t[2],t[5],t[8],0,0,0,0,1),this}extractBasis(e,t,n){return this.determinantAffine()===0?(e.set(1,0,0),t.set(0,1,0),n.set(0,0,1),this):(e.setFromMatrixColumn(this,0),t.setFromMatrixColumn(this,1),n.setFromMatrixColumn(this,2),this)}makeBasis(e,t,n){return this.set(e.x,t.x,n.x,0,e.y,t.y,n.y,0,e.z,t.z,n.z,0,0,0,0,1),this}extractRotation(e){if(e.determinantAffine()===0)return this.identity();let t=this.elements,n=e.elements,r=1/zr.setFromMatrixColumn(e,0).length(),i=1/zr.setFromMatrixColumn(e,1).length(),a=1/zr.setFromMatrixColumn(e,2).length();return t[0]=n[0]*r,t[1]=n[1]*r,t[2]=n[2]*r,t[3]=0,t[4]=n[4]*i,t[5]=n[5]*i,t[6]=n[6]*i,t[7]=0,t[8]=n[8]*a,t[9]=n[9]*a,t[10]=n[10]*a,t[11]=0,t[12]=0,t[13]=0,t[14]=0,t[15]=1,this}makeRotationFromEuler(e){let t=this.elements,n=e.x,r=e.y,i=e.z,a=Math.cos(n),o=Math.sin(n),s=Math.cos(r),c=Math.sin(r),l=Math.cos(i),u=Math.sin(i);if(e.order===`XYZ`){let e=a*l,n=a*u,r=o*l,i=o*u;t[0]=s*l,t[4]=-s*u,t[8]=c,t[1]=n+r*c,t[5]=e-i*c,t[9]=-o*s,t[2]=i-e*c,t[6]=r+n*c,t[10]=a*s}else if(e.order===`YXZ`){let e=s*l,n=s*u,r=c*l,i=c*u;t[0]=e+i*o,t[4]=r*o-n,t[8]=a*c,t[1]=a*u,t[5]=a*l,t[9]=-o,t[2]=n*o-r,t[6]=i+e*o,t[10]=a*s}else if(e.order===`ZXY`){let e=s*l,n=s*u,r=c*l,i=c*u;t[0]=e-i*o,t[4]=-a*u,t[8]=r+n*o,t[1]=n+r*o,t[5]=a*l,t[9]=i-e*o,t[2]=-a*c,t[6]=o,t[10]=a*s}else if(e.order===`ZYX`){let e=a*l,n=a*u,r=o*l,i=o*u;t[0]=s*l,t[4]=r*c-n,t[8]=e*c+i,t[1]=s*u,t[5]=i*c+e,t[9]=n*c-r,t[2]=-c,t[6]=o*s,t[10]=a*s}else if(e.order===`YZX`){let e=a*s,n=a*c,r=o*s,i=o*c;t[0]=s*l,t[4]=i-e*u,t[8]=r*u+n,t[1]=u,t[5]=a*l,t[9]=-o*l,t[2]=-c*l,t[6]=n*u+r,t[10]=e-i*u}else if(e.order===`XZY`){let e=a*s,n=a*c,r=o*s,i=o*c;t[0]=s*l,t[4]=-u,t[8]=c*l,t[1]=e*u+i,t[5]=a*l,t[9]=n*u-r,t[2]=r*u-n,t[6]=o*l,t[10]=i*u+e}return t[3]=0,t[7]=0,t[11]=0,t[12]=0,t[13]=0,t[14]=0,t[15]=1,this}makeRotationFromQuaternion(e){return this.compose(Vr,e,Hr)}lookAt(e,t,n){let r=this.elements;return Gr.subVectors(e,t),Gr.lengthSq()===0&&(Gr.z=1),Gr.normalize(),Ur.crossVectors(n,Gr),Ur.lengthSq()===0&&(Math.abs(n.z)===1?Gr.x+=1e-4:Gr.z+=1e-4,Gr.normalize(),Ur.crossVectors(n,Gr)),Ur.normalize(),Wr.crossVectors(Gr,Ur),r[0]=Ur.x,r[4]=Wr.x,r[8]=Gr.x,r[1]=Ur.y,r[5]=Wr.y,r[9]=Gr.y,r[2]=Ur.z,r[6]=Wr.z,r[10]=Gr.z,this}multiply(e){return this.multiplyMatrices(this,e)}premultiply(e){return this.multiplyMatrices(e,this)}multiplyMatrices(e,t){let n=e.elements,r=t.elements,i=this.elements,a=n[0],o=n[4],s=n[8],c=n[12],l=n[1],u=n[5],d=n[9],f=n[13],p=n[2],m=n[6],h=n[10],g=n[14],_=n[3],v=n[7],y=n[11],b=n[15],x=r[0],S=r[4],C=r[8],w=r[12],T=r[1],E=r[5],D=r[9],O=r[13],k=r[2],A=r[6],j=r[10],M=r[14],N=r[3],P=r[7],ee=r[11],F=r[15];return i[0]=a*x+o*T+s*k+c*N,i[4]=a*S+o*E+s*A+c*P,i[8]=a*C+o*D+s*j+c*ee,i[12]=a*w+o*O+s*M+c*F,i[1]=l*x+u*T+d*k+f*N,i[5]=l*S+u*E+d*A+f*P,i[9]=l*C+u*D+d*j+f*ee,i[13]=l*w+u*O+d*M+f*F,i[2]=p*x+m*T+h*k+g*N,i[6]=p*S+m*E+h*A+g*P,i[10]=p*C+m*D+h*j+g*ee,i[14]=p*w+m*O+h*M+g*F,i[3]=_*x+v*T+y*k+b*N,i[7]=_*S+v*E+y*A+b*P,i[11]=_*C+v*D+y*j+b*ee,i[15]=_*w+v*O+y*M+b*F,this}multiplyScalar(e){let t=this.elements;return t[0]*=e,t[4]*=e,t[8]*=e,t[12]*=e,t[1]*=e,t[5]*=e,t[9]*=e,t[13]*=e,t[2]*=e,t[6]*=e,t[10]*=e,t[14]*=e,t[3]*=e,t[7]*=e,t[11]*=e,t[15]*=e,this}determinant(){let e=this.elements,t=e[0],n=e[4],r=e[8],i=e[12],a=e[1],o=e[5],s=e[9],c=e[13],l=e[2],u=e[6],d=e[10],f=e[14],p=e[3],m=e[7],h=e[11],g=e[15],_=s*f-c*d,v=o*f-c*u,y=o*d-s*u,b=a*f-c*l,x=a*d-s*l,S=a*u-o*l;return t*(m*_-h*v+g*y)-n*(p*_-h*b+g*x)+r*(p*v-m*b+g*S)-i*(p*y-m*x+h*S)}determinantAffine(){let e=this.elements,t=e[0],n=e[4],r=e[8],i=e[1],a=e[5],o=e[9],s=e[2],c=e[6],l=e[10];return t*(a*l-o*c)-n*(i*l-o*s)+r*(i*c-a*s)}transpose(){let e=this.elements,t;return t=e[1],e[1]=e[4],e[4]=t,t=e[2],e[2]=e[8],e[8]=t,t=e[6],e[6]=e[9],e[9]=t,t=e[3],e[3]=e[12],e[12]=t,t=e[7],e[7]=e[13],e[13]=t,t=e[11],e[11]=e[14],e[14]=t,this}setPosition(e,t,n){let r=this.elements;return e.isVector3?(r[12]=e.x,r[13]=e.y,r[14]=e.z):(r[12]=e,r[13]=t,r[14]=n),this}invert(){let e=this.elements,t=e[0],n=e[1],r=e[2],i=e[3],a=e[4],o=e[5],s=e[6],c=e[7],l=e[8],u=e[9],d=e[10],f=e[11],p=e[12],m=e[13],h=e[14],g=e[15],_=t*o-n*a,v=t*s-r*a,y=t*c-i*a,b=n*s-r*o,x=n*c-i*o,S=r*c-i*s,C=l*m-u*p,w=l*h-d*p,T=l*g-f*p,E=u*h-d*m,D=u*g-f*m,O=d*g-f*h,k=_*O-v*D+y*E+b*T-x*w+S*C;if(k===0)return this.set(0,0,0,0,0,0,0,0,0,0,0,0,0,0,0,0);let A=1/k;return e[0]=(o*O-s*D+c*E)*A,e[1]=(r*D-n*O-i*E)*A,e[2]=(m*S-h*x+g*b)*A,e[3]=(d*x-u*S-f*b)*A,e[4]=(s*T-a*O-c*w)*A,e[5]=(t*O-r*T+i*w)*A,e[6]=(h*y-p*S-g*v)*A,e[7]=(l*S-d*y+f*v)*A,e[8]=(a*D-o*T+c*C)*A,e[9]=(n*T-t*D-i*C)*A,e[10]=(p*x-m*y+g*_)*A,e[11]=(u*y-l*x-f*_)*A,e[12]=(o*w-a*E-s*C)*A,e[13]=(t*E-n*w+r*C)*A,e[14]=(m*v-p*b-h*_)*A,e[15]=(l*b-u*v+d*_)*A,this}scale(e){let t=this.elements,n=e.x,r=e.y,i=e.z;return t[0]*=n,t[4]*=r,t[8]*=i,t[1]*=n,t[5]*=r,t[9]*=i,t[2]*=n,t[6]*=r,t[10]*=i,t[3]*=n,t[7]*=r,t[11]*=i,this}getMaxScaleOnAxis(){let e=this.elements,t=e[0]*e[0]+e[1]*e[1]+e[2]*e[2],n=e[4]*e[4]+e[5]*e[5]+e[6]*e[6],r=e[8]*e[8]+e[9]*e[9]+e[10]*e[10];return Math.sqrt(Math.max(t,n,r))}makeTranslation(e,t,n){return e.isVector3?this.set(1,0,0,e.x,0,1,0,e.y,0,0,1,e.z,0,0,0,1):this.set(1,0,0,e,0,1,0,t,0,0,1,n,0,0,0,1),this}makeRotationX(e){let t=Math.cos(e),n=Math.sin(e);return this.set(1,0,0,0,0,t,-n,0,0,n,t,0,0,0,0,1),this}makeRotationY(e){let t=Math.cos(e),n=Math.sin(e);return this.set(t,0,n,0,0,1,0,0,-n,0,t,0,0,0,0,1),this}makeRotationZ(e){let t=Math.cos(e),n=Math.sin(e);return this.set(t,-n,0,0,n,t,0,0,0,0,1,0,0,0,0,1),this}makeRotationAxis(e,t){let n=Math.cos(t),r=Math.sin(t),i=1-n,a=e.x,o=e.y,s=e.z,c=i*a,l=i*o;return this.set(c*a+n,c*o-r*s,c*s+r*o,0,c*o+r*s,l*o+n,l*s-r*a,0,c*s-r*o,l*s+r*a,i*s*s+n,0,0,0,0,1),this}makeScale(e,t,n){return this.set(e,0,0,0,0,t,0,0,0,0,n,0,0,0,0,1),this}makeShear(e,t,n,r,i,a){return this.set(1,n,i,0,e,1,a,0,t,r,1,0,0,0,0,1),this}compose(e,t,n){let r=this.elements,i=t._x,a=t._y,o=t._z,s=t._w,c=i+i,l=a+a,u=o+o,d=i*c,f=i*l,p=i*u,m=a*l,h=a*u,g=o*u,_=s*c,v=s*l,y=s*u,b=n.x,x=n.y,S=n.z;return r[0]=(1-(m+g))*b,r[1]=(f+y)*b,r[2]=(p-v)*b,r[3]=0,r[4]=(f-y)*x,r[5]=(1-(d+g))*x,r[6]=(h+_)*x,r[7]=0,r[8]=(p+v)*S,r[9]=(h-_)*S,r[10]=(1-(d+m))*S,r[11]=0,r[12]=e.x,r[13]=e.y,r[14]=e.z,r[15]=1,this}decompose(e,t,n){let r=this.elements;e.x=r[12],e.y=r[13],e.z=r[14];let i=this.determinantAffine();if(i===0)return n.set(1,1,1),t.identity(),this;let a=zr.set(r[0],r[1],r[2]).length(),o=zr.set(r[4],r[5],r[6]).length(),s=zr.set(r[8],r[9],r[10]).length();i<0&&(a=-a),Br.copy(this);let c=1/a,l=1/o,u=1/s;return Br.elements[0]*=c,Br.elements[1]*=c,Br.elements[2]*=c,Br.elements[4]*=l,Br.elements[5]*=l,Br.elements[6]*=l,Br.elements[8]*=u,Br.elements[9]*=u,Br.elements[10]*=u,t.setFromRotationMatrix(Br),n.x=a,n.y=o,n.z=s,this}makePerspective(e,t,n,r,i,a,o=An,s=!1){let c=this.elements,l=2*i/(t-e),u=2*i/(n-r),d=(t+e)/(t-e),f=(n+r)/(n-r),p,m;if(s)p=i/(a-i),m=a*i/(a-i);else if(o===2e3)p=-(a+i)/(a-i),m=-2*a*i/(a-i);else if(o===2001)p=-a/(a-i),m=-a*i/(a-i);else throw Error(`THREE.Matrix4.makePerspective(): Invalid coordinate system: `+o);return c[0]=l,c[4]=0,c[8]=d,c[12]=0,c[1]=0,c[5]=u,c[9]=f,c[13]=0,c[2]=0,c[6]=0,c[10]=p,c[14]=m,c[3]=0,c[7]=0,c[11]=-1,c[15]=0,this}makeOrthographic(e,t,n,r,i,a,o=An,s=!1){let c=this.elements,l=2/(t-e),u=2/(n-r),d=-(t+e)/(t-e),f=-(n+r)/(n-r),p,m;if(s)p=1/(a-i),m=a/(a-i);else if(o===2e3)p=-2/(a-i),m=-(a+i)/(a-i);else if(o===2001)p=-1/(a-i),m=-i/(a-i);else throw Error(`THREE.Matrix4.makeOrthographic(): Invalid coordinate system: `+o);return c[0]=l,c[4]=0,c[8]=0,c[12]=d,c[1]=0,c[5]=u,c[9]=0,c[13]=f,c[2]=0,c[6]=0,c[10]=p,c[14]=m,c[3]=0,c[7]=0,c[11]=0,c[15]=1,this}equals(e){let t=this.elements,n=e.elements;for(let e=0;e<16;e++)if(t[e]!==n[e])return!1;return!0}fromArray(e,t=0){for(let n=0;n<16;n++)this.elements[n]=e[n+t];return this}toArray(e=[],t=0){let n=this.elements;return e[t]=n[0],e[t+1]=n[1],e[t+2]=n[2],e[t+3]=n[3],e[t+4]=n[4],e[t+5]=n[5],e[t+6]=n[6],e[t+7]=n[7],e[t+8]=n[8],e[t+9]=n[9],e[t+10]=n[10],e[t+11]=n[11],e[t+12]=n[12],e[t+13]=n[13],e[t+14]=n[14],e[t+15]=n[15],e}},zr=new q,Br=new Rr,Vr=new q(0,0,0),Hr=new q(1,1,1),Ur=new q,Wr=new q,Gr=new q,Kr=new Rr,qr=new hr,Jr=class e{constructor(t=0,n=0,r=0,i=e.DEFAULT_ORDER){this.isEuler=!0,this._x=t,this._y=n,this._z=r,this._order=i}get x(){return this._x}set x(e){this._x=e,this._onChangeCallback()}get y(){return this._y}set y(e){this._y=e,this._onChangeCallback()}get z(){return this._z}set z(e){this._z=e,this._onChangeCallback()}get order(){return this._order}set order(e){this._order=e,this._onChangeCallback()}set(e,t,n,r=this._order){return this._x=e,this._y=t,this._z=n,this._order=r,this._onChangeCallback(),this}clone(){return new this.constructor(this._x,this._y,this._z,this._order)}copy(e){return this._x=e._x,this._y=e._y,this._z=e._z,this._order=e._order,this._onChangeCallback(),this}setFromRotationMatrix(e,t=this._order,n=!0){let r=e.elements,i=r[0],a=r[4],o=r[8],s=r[1],c=r[5],l=r[9],u=r[2],d=r[6],f=r[10];switch(t){case`XYZ`:this._y=Math.asin(G(o,-1,1)),Math.abs(o)<.9999999?(this._x=Math.atan2(-l,f),this._z=Math.atan2(-a,i)):(this._x=Math.atan2(d,c),this._z=0);break;case`YXZ`:this._x=Math.asin(-G(l,-1,1)),Math.abs(l)<.9999999?(this._y=Math.atan2(o,f),this._z=Math.atan2(s,c)):(this._y=Math.atan2(-u,i),this._z=0);break;case`ZXY`:this._x=Math.asin(G(d,-1,1)),Math.abs(d)<.9999999?(this._y=Math.atan2(-u,f),this._z=Math.atan2(-a,c)):(this._y=0,this._z=Math.atan2(s,i));break;case`ZYX`:this._y=Math.asin(-G(u,-1,1)),Math.abs(u)<.9999999?(this._x=Math.atan2(d,f),this._z=Math.atan2(s,i)):(this._x=0,this._z=Math.atan2(-a,c));break;case`YZX`:this._z=Math.asin(G(s,-1,1)),Math.abs(s)<.9999999?(this._x=Math.atan2(-l,c),this._y=Math.atan2(-u,i)):(this._x=0,this._y=Math.atan2(o,f));break;case`XZY`:this._z=Math.asin(-G(a,-1,1)),Math.abs(a)<.9999999?(this._x=Math.atan2(d,c),this._y=Math.atan2(o,i)):(this._x=Math.atan2(-l,f),this._y=0);break;default:U(`Euler: .setFromRotationMatrix() encountered an unknown order: `+t)}return this._order=t,n===!0&&this._onChangeCallback(),this}setFromQuaternion(e,t,n){return Kr.makeRotationFromQuaternion(e),this.setFromRotationMatrix(Kr,t,n)}setFromVector3(e,t=this._order){return this.set(e.x,e.y,e.z,t)}reorder(e){return qr.setFromEuler(this),this.setFromQuaternion(qr,e)}equals(e){return e._x===this._x&&e._y===this._y&&e._z===this._z&&e._order===this._order}fromArray(e){return this._x=e[0],this._y=e[1],this._z=e[2],e[3]!==void 0&&(this._order=e[3]),this._onChangeCallback(),this}toArray(e=[],t=0){return e[t]=this._x,e[t+1]=this._y,e[t+2]=this._z,e[t+3]=this._order,e}_onChange(e){return this._onChangeCallback=e,this}_onChangeCallback(){}*[Symbol.iterator](){yield this._x,yield this._y,yield this._z,yield this._order}};Jr.DEFAULT_ORDER=`XYZ`;var Yr=class{constructor(){this.mask=1}set(e){this.mask=1<<e>>>0}enable(e){this.mask|=1<<e}enableAll(){this.mask=-1}toggle(e){this.mask^=1<<e}disable(e){this.mask&=~(1<<e)}disableAll(){this.mask=0}test(e){return(this.mask&e.mask)!==0}isEnabled(e){return!!(this.mask&1<<e)}},Xr=0,Zr=new q,Qr=new hr,$r=new Rr,ei=new q,ti=new q,ni=new q,ri=new hr,ii=new q(1,0,0),ai=new q(0,1,0),oi=new q(0,0,1),si={type:`added`},ci={type:`removed`},li={type:`childadded`,child:null},ui={type:`childremoved`,child:null},di=class e extends Vn{constructor(){super(),this.isObject3D=!0,Object.defineProperty(this,"id",{value:Xr++}),this.uuid=Kn(),this.name=``,this.type=`Object3D`,this.parent=null,this.children=[],this.up=e.DEFAULT_UP.clone();let t=new q,n=new Jr,r=new hr,i=new q(1,1,1);function a(){r.setFromEuler(n,!1)}function o(){n.setFromQuaternion(r,void 0,!1)}n._onChange(a),r._onChange(o),Object.defineProperties(this,{position:{configurable:!0,enumerable:!0,value:t},rotation:{configurable:!0,enumerable:!0,value:n},quaternion:{configurable:!0,enumerable:!0,value:r},scale:{configurable:!0,enumerable:!0,value:i},modelViewMatrix:{value:new Rr},normalMatrix:{value:new J}}),this.matrix=new Rr,this.matrixWorld=new Rr,this.matrixAutoUpdate=e.DEFAULT_MATRIX_AUTO_UPDATE,this.matrixWorldAutoUpdate=e.DEFAULT_MATRIX_WORLD_AUTO_UPDATE,this.matrixWorldNeedsUpdate=!1,this.layers=new Yr,this.visible=!0,this.castShadow=!1,this.receiveShadow=!1,this.frustumCulled=!0,this.renderOrder=0,this.animations=[],this.customDepthMaterial=void 0,this.customDistanceMaterial=void 0,this.static=!1,this.userData={},this.pivot=null}onBeforeShadow(){}onAfterShadow(){}onBeforeRender(){}onAfterRender(){}applyMatrix4(e){this.matrixAutoUpdate&&this.updateMatrix(),this.matrix.premultiply(e),this.matrix.decompose(this.position,this.quaternion,this.scale),this.pivot!==null&&this.position.copy(this.pivot).applyMatrix4(this.matrix).sub(this.pivot)}applyQuaternion(e){return this.quaternion.premultiply(e),this}setRotationFromAxisAngle(e,t){this.quaternion.setFromAxisAngle(e,t)}setRotationFromEuler(e){this.quaternion.setFromEuler(e,!0)}setRotationFromMatrix(e){this.quaternion.setFromRotationMatrix(e)}setRotationFromQuaternion(e){this.quaternion.copy(e)}rotateOnAxis(e,t){return Qr.setFromAxisAngle(e,t),this.quaternion.multiply(Qr),this}rotateOnWorldAxis(e,t){return Qr.setFromAxisAngle(e,t),this.quaternion.premultiply(Qr),this}rotateX(e){return this.rotateOnAxis(ii,e)}rotateY(e){return this.rotateOnAxis(ai,e)}rotateZ(e){return this.rotateOnAxis(oi,e)}translateOnAxis(e,t){return Zr.copy(e).applyQuaternion(this.quaternion),this.position.add(Zr.multiplyScalar(t)),this}translateX(e){return this.translateOnAxis(ii,e)}translateY(e){return this.translateOnAxis(ai,e)}translateZ(e){return this.translateOnAxis(oi,e)}localToWorld(e){return this.updateWorldMatrix(!0,!1),e.applyMatrix4(this.matrixWorld)}worldToLocal(e){return this.updateWorldMatrix(!0,!1),e.applyMatrix4($r.copy(this.matrixWorld).invert())}lookAt(e,t,n){e.isVector3?ei.copy(e):ei.set(e,t,n);let r=this.parent;this.updateWorldMatrix(!0,!1),ti.setFromMatrixPosition(this.matrixWorld),this.isCamera||this.isLight?$r.lookAt(ti,ei,this.up):$r.lookAt(ei,ti,this.up),this.quaternion.setFromRotationMatrix($r),r&&($r.extractRotation(r.matrixWorld),Qr.setFromRotationMatrix($r),this.quaternion.premultiply(Qr.invert()))}add(e){if(arguments.length>1){for(let e=0;e<arguments.length;e++)this.add(arguments[e]);return this}return e===this?(W(`Object3D.add: object can't be added as a child of itself.`,e),this):(e&&e.isObject3D?(e.removeFromParent(),e.parent=this,this.children.push(e),e.dispatchEvent(si),li.child=e,this.dispatchEvent(li),li.child=null):W(`Object3D.add: object not an instance of THREE.Object3D.`,e),this)}remove(e){if(arguments.length>1){for(let e=0;e<arguments.length;e++)this.remove(arguments[e]);return this}let t=this.children.indexOf(e);return t!==-1&&(e.parent=null,this.children.splice(t,1),e.dispatchEvent(ci),ui.child=e,this.dispatchEvent(ui),ui.child=null),this}removeFromParent(){let e=this.parent;return e!==null&&e.remove(this),this}clear(){return this.remove(...this.children)}attach(e){return this.updateWorldMatrix(!0,!1),$r.copy(this.matrixWorld).invert(),e.parent!==null&&(e.parent.updateWorldMatrix(!0,!1),$r.multiply(e.parent.matrixWorld)),e.applyMatrix4($r),e.removeFromParent(),e.parent=this,this.children.push(e),e.updateWorldMatrix(!1,!0),e.dispatchEvent(si),li.child=e,this.dispatchEvent(li),li.child=null,this}getObjectById(e){return this.getObjectByProperty(`id`,e)}getObjectByName(e){return this.getObjectByProperty(`name`,e)}getObjectByProperty(e,t){if(this[e]===t)return this;for(let n=0,r=this.children.length;n<r;n++){let r=this.children[n].getObjectByProperty(e,t);if(r!==void 0)return r}}getObjectsByProperty(e,t,n=[]){this[e]===t&&n.push(this);let r=this.children;for(let i=0,a=r.length;i<a;i++)r[i].getObjectsByProperty(e,t,n);return n}getWorldPosition(e){return this.updateWorldMatrix(!0,!1),e.setFromMatrixPosition(this.matrixWorld)}getWorldQuaternion(e){return this.updateWorldMatrix(!0,!1),this.matrixWorld.decompose(ti,e,ni),e}getWorldScale(e){return this.updateWorldMatrix(!0,!1),this.matrixWorld.decompose(ti,ri,e),e}getWorldDirection(e){this.updateWorldMatrix(!0,!1);let t=this.matrixWorld.elements;return e.set(t[8],t[9],t[10]).normalize()}raycast(){}intersectsFrustum(){return!0}traverse(e){e(this);let t=this.children;for(let n=0,r=t.length;n<r;n++)t[n].traverse(e)}traverseVisible(e){if(this.visible===!1)return;e(this);let t=this.children;for(let n=0,r=t.length;n<r;n++)t[n].traverseVisible(e)}traverseAncestors(e){let t=this.parent;t!==null&&(e(t),t.traverseAncestors(e))}updateMatrix(){this.matrix.compose(this.position,this.quaternion,this.scale);let e=this.pivot;if(e!==null){let t=e.x,n=e.y,r=e.z,i=this.matrix.elements;i[12]+=t-i[0]*t-i[4]*n-i[8]*r,i[13]+=n-i[1]*t-i[5]*n-i[9]*r,i[14]+=r-i[2]*t-i[6]*n-i[10]*r}this.matrixWorldNeedsUpdate=!0}updateMatrixWorld(e){this.matrixAutoUpdate&&this.updateMatrix(),(this.matrixWorldNeedsUpdate||e)&&(this.matrixWorldAutoUpdate===!0&&(this.parent===null?this.matrixWorld.copy(this.matrix):this.matrixWorld.multiplyMatrices(this.parent.matrixWorld,this.matrix)),this.matrixWorldNeedsUpdate=!1,e=!0);let t=this.children;for(let n=0,r=t.length;n<r;n++)t[n].updateMatrixWorld(e)}updateWorldMatrix(e,t,n=!1){let r=this.parent;if(e===!0&&r!==null&&r.updateWorldMatrix(!0,!1),this.matrixAutoUpdate&&this.updateMatrix(),(this.matrixWorldNeedsUpdate||n)&&(this.matrixWorldAutoUpdate===!0&&(this.parent===null?this.matrixWorld.copy(this.matrix):this.matrixWorld.multiplyMatrices(this.parent.matrixWorld,this.matrix)),this.matrixWorldNeedsUpdate=!1,n=!0),t===!0){let e=this.children;for(let t=0,r=e.length;t<r;t++)e[t].updateWorldMatrix(!1,!0,n)}}toJSON(e){let t=e===void 0||typeof e==`string`,n={};t&&(e={geometries:{},materials:{},textures:{},images:{},shapes:{},skeletons:{},animations:{},nodes:{}},n.metadata={version:4.7,type:`Object`,generator:`Object3D.toJSON`});let r={};r.uuid=this.uuid,r.type=this.type,r.name=this.name,r.castShadow=this.castShadow,r.receiveShadow=this.receiveShadow,r.visible=this.visible,r.frustumCulled=this.frustumCulled,r.renderOrder=this.renderOrder,r.static=this.static,r.matrixAutoUpdate=this.matrixAutoUpdate,Object.keys(this.userData).length>0&&(r.userData=this.userData),r.layers=this.layers.mask,r.matrix=this.matrix.toArray(),r.up=this.up.toArray(),this.pivot!==null&&(r.pivot=this.pivot.toArray()),this.morphTargetDictionary!==void 0&&(r.morphTargetDictionary=Object.assign({},this.morphTargetDictionary)),this.morphTargetInfluences!==void 0&&(r.morphTargetInfluences=this.morphTargetInfluences.slice()),this.isInstancedMesh&&(r.type=`InstancedMesh`,r.count=this.count,r.instanceMatrix=this.instanceMatrix.toJSON(),this.instanceColor!==null&&(r.instanceColor=this.instanceColor.toJSON())),this.isBatchedMesh&&(r.type=`BatchedMesh`,r.perObjectFrustumCulled=this.perObjectFrustumCulled,r.sortObjects=this.sortObjects,r.drawRanges=this._drawRanges,r.reservedRanges=this._reservedRanges,r.geometryInfo=this._geometryInfo.map(e=>({...e,boundingBox:e.boundingBox?e.boundingBox.toJSON():void 0,boundingSphere:e.boundingSphere?e.boundingSphere.toJSON():void 0})),r.instanceInfo=this._instanceInfo.map(e=>({...e})),r.availableInstanceIds=this._availableInstanceIds.slice(),r.availableGeometryIds=this._availableGeometryIds.slice(),r.nextIndexStart=this._nextIndexStart,r.nextVertexStart=this._nextVertexStart,r.geometryCount=this._geometryCount,r.maxInstanceCount=this._maxInstanceCount,r.maxVertexCount=this._maxVertexCount,r.maxIndexCount=this._maxIndexCount,r.geometryInitialized=this._geometryInitialized,r.matricesTexture=this._matricesTexture.toJSON(e),r.indirectTexture=this._indirectTexture.toJSON(e),this._colorsTexture!==null&&(r.colorsTexture=this._colorsTexture.toJSON(e)),this.boundingSphere!==null&&(r.boundingSphere=this.boundingSphere.toJSON()),this.boundingBox!==null&&(r.boundingBox=this.boundingBox.toJSON()));function i(t,n){return t[n.uuid]===void 0&&(t[n.uuid]=n.toJSON(e)),n.uuid}if(this.isScene)this.background&&(this.background.isColor?r.background=this.background.toJSON():this.background.isTexture&&(r.background=this.background.toJSON(e).uuid)),this.environment&&this.environment.isTexture&&this.environment.isRenderTargetTexture!==!0&&(r.environment=this.environment.toJSON(e).uuid);else if(this.isMesh||this.isLine||this.isPoints){r.geometry=i(e.geometries,this.geometry);let t=this.geometry.parameters;if(t!==void 0&&t.shapes!==void 0){let n=t.shapes;if(Array.isArray(n))for(let t=0,r=n.length;t<r;t++){let r=n[t];i(e.shapes,r)}else i(e.shapes,n)}}if(this.isSkinnedMesh&&(r.bindMode=this.bindMode,r.bindMatrix=this.bindMatrix.toArray(),this.skeleton!==void 0&&(i(e.skeletons,this.skeleton),r.skeleton=this.skeleton.uuid)),this.material!==void 0){if(Array.isArray(this.material)){let t=[];for(let n=0,r=this.material.length;n<r;n++)t.push(i(e.materials,this.material[n]));r.material=t}else r.material=i(e.materials,this.material)}if(this.children.length>0){r.children=[];for(let t=0;t<this.children.length;t++)r.children.push(this.children[t].toJSON(e).object)}if(this.animations.length>0){r.animations=[];for(let t=0;t<this.animations.length;t++){let n=this.animations[t];r.animations.push(i(e.animations,n))}}if(t){let t=a(e.geometries),r=a(e.materials),i=a(e.textures),o=a(e.images),s=a(e.shapes),c=a(e.skeletons),l=a(e.animations),u=a(e.nodes);t.length>0&&(n.geometries=t),r.length>0&&(n.materials=r),i.length>0&&(n.textures=i),o.length>0&&(n.images=o),s.length>0&&(n.shapes=s),c.length>0&&(n.skeletons=c),l.length>0&&(n.animations=l),u.length>0&&(n.nodes=u)}return n.object=r,n;function a(e){let t=[];for(let n in e){let r=e[n];delete r.metadata,t.push(r)}return t}}clone(e){return new this.constructor().copy(this,e)}copy(e,t=!0){if(this.name=e.name,this.up.copy(e.up),this.position.copy(e.position),this.rotation.order=e.rotation.order,this.quaternion.copy(e.quaternion),this.scale.copy(e.scale),this.pivot=e.pivot===null?null:e.pivot.clone(),this.matrix.copy(e.matrix),this.matrixWorld.copy(e.matrixWorld),this.matrixAutoUpdate=e.matrixAutoUpdate,this.matrixWorldAutoUpdate=e.matrixWorldAutoUpdate,this.matrixWorldNeedsUpdate=e.matrixWorldNeedsUpdate,this.layers.mask=e.layers.mask,this.visible=e.visible,this.castShadow=e.castShadow,this.receiveShadow=e.receiveShadow,this.frustumCulled=e.frustumCulled,this.renderOrder=e.renderOrder,this.static=e.static,this.animations=e.animations.slice(),this.userData=JSON.parse(JSON.stringify(e.userData)),t===!0)for(let t=0;t<e.children.length;t++){let n=e.children[t];this.add(n.clone())}return this}dispose(){this.dispatchEvent({type:`dispose`})}};di.DEFAULT_UP=new q(0,1,0),di.DEFAULT_MATRIX_AUTO_UPDATE=!0,di.DEFAULT_MATRIX_WORLD_AUTO_UPDATE=!0;var fi=class extends di{constructor(){super(),this.isGroup=!0,this.type=`Group`}},pi={type:`move`},mi=class{constructor(){this._targetRay=null,this._grip=null,this._hand=null}getHandSpace(){return this._hand===null&&(this._hand=new fi,this._hand.matrixAutoUpdate=!1,this._hand.visible=!1,this._hand.joints={},this._hand.inputState={pinching:!1}),this._hand}getTargetRaySpace(){return this._targetRay===null&&(this._targetRay=new fi,this._targetRay.matrixAutoUpdate=!1,this._targetRay.visible=!1,this._targetRay.hasLinearVelocity=!1,this._targetRay.linearVelocity=new q,this._targetRay.hasAngularVelocity=!1,this._targetRay.angularVelocity=new q),this._targetRay}getGripSpace(){return this._grip===null&&(this._grip=new fi,this._grip.matrixAutoUpdate=!1,this._grip.visible=!1,this._grip.hasLinearVelocity=!1,this._grip.linearVelocity=new q,this._grip.hasAngularVelocity=!1,this._grip.angularVelocity=new q,this._grip.eventsEnabled=!1),this._grip}dispatchEvent(e){return this._targetRay!==null&&this._targetRay.dispatchEvent(e),this._grip!==null&&this._grip.dispatchEvent(e),this._hand!==null&&this._hand.dispatchEvent(e),this}connect(e){if(e&&e.hand){let t=this._hand;if(t)for(let n of e.hand.values())this._getHandJoint(t,n)}return this.dispatchEvent({type:`connected`,data:e}),this}disconnect(e){return this.dispatchEvent({type:`disconnected`,data:e}),this._targetRay!==null&&(this._targetRay.visible=!1),this._grip!==null&&(this._grip.visible=!1),this._hand!==null&&(this._hand.visible=!1),this}update(e,t,n){let r=null,i=null,a=null,o=this._targetRay,s=this._grip,c=this._hand;if(e&&t.session.visibilityState!==`visible-blurred`){if(c&&e.hand){a=!0;for(let r of e.hand.values()){let e=t.getJointPose(r,n),i=this._getHandJoint(c,r);e!==null&&(i.matrix.fromArray(e.transform.matrix),i.matrix.decompose(i.position,i.quaternion,i.scale),i.matrixWorldNeedsUpdate=!0,i.jointRadius=e.radius),i.visible=e!==null}let r=c.joints[`index-finger-tip`],i=c.joints[`thumb-tip`],o=r.position.distanceTo(i.position);c.inputState.pinching&&o>.025?(c.inputState.pinching=!1,this.dispatchEvent({type:`pinchend`,handedness:e.handedness,target:this})):!c.inputState.pinching&&o<=.015&&(c.inputState.pinching=!0,this.dispatchEvent({type:`pinchstart`,handedness:e.handedness,target:this}))}else s!==null&&e.gripSpace&&(i=t.getPose(e.gripSpace,n),i!==null&&(s.matrix.fromArray(i.transform.matrix),s.matrix.decompose(s.position,s.quaternion,s.scale),s.matrixWorldNeedsUpdate=!0,i.linearVelocity?(s.hasLinearVelocity=!0,s.linearVelocity.copy(i.linearVelocity)):s.hasLinearVelocity=!1,i.angularVelocity?(s.hasAngularVelocity=!0,s.angularVelocity.copy(i.angularVelocity)):s.hasAngularVelocity=!1,s.eventsEnabled&&s.dispatchEvent({type:`gripUpdated`,data:e,target:this})));o!==null&&(r=t.getPose(e.targetRaySpace,n),r===null&&i!==null&&(r=i),r!==null&&(o.matrix.fromArray(r.transform.matrix),o.matrix.decompose(o.position,o.quaternion,o.scale),o.matrixWorldNeedsUpdate=!0,r.linearVelocity?(o.hasLinearVelocity=!0,o.linearVelocity.copy(r.linearVelocity)):o.hasLinearVelocity=!1,r.angularVelocity?(o.hasAngularVelocity=!0,o.angularVelocity.copy(r.angularVelocity)):o.hasAngularVelocity=!1,this.dispatchEvent(pi)))}return o!==null&&(o.visible=r!==null),s!==null&&(s.visible=i!==null),c!==null&&(c.visible=a!==null),this}_getHandJoint(e,t){if(e.joints[t.jointName]===void 0){let n=new fi;n.matrixAutoUpdate=!1,n.visible=!1,e.joints[t.jointName]=n,e.add(n)}return e.joints[t.jointName]}},hi={aliceblue:15792383,antiquewhite:16444375,aqua:65535,aquamarine:8388564,azure:15794175,beige:16119260,bisque:16770244,black:0,blanchedalmond:16772045,blue:255,blueviolet:9055202,brown:10824234,burlywood:14596231,cadetblue:6266528,chartreuse:8388352,chocolate:13789470,coral:16744272,cornflowerblue:6591981,cornsilk:16775388,crimson:14423100,cyan:65535,darkblue:139,darkcyan:35723,darkgoldenrod:12092939,darkgray:11119017,darkgreen:25600,darkgrey:11119017,darkkhaki:12433259,darkmagenta:9109643,darkolivegreen:5597999,darkorange:16747520,darkorchid:10040012,darkred:9109504,darksalmon:15308410,darkseagreen:9419919,darkslateblue:4734347,darkslategray:3100495,darkslategrey:3100495,darkturquoise:52945,darkviolet:9699539,deeppink:16716947,deepskyblue:49151,dimgray:6908265,dimgrey:6908265,dodgerblue:2003199,firebrick:11674146,floralwhite:16775920,forestgreen:2263842,fuchsia:16711935,gainsboro:14474460,ghostwhite:16316671,gold:16766720,goldenrod:14329120,gray:8421504,green:32768,greenyellow:11403055,grey:8421504,honeydew:15794160,hotpink:16738740,indianred:13458524,indigo:4915330,ivory:16777200,khaki:15787660,lavender:15132410,lavenderblush:16773365,lawngreen:8190976,lemonchiffon:16775885,lightblue:11393254,lightcoral:15761536,lightcyan:14745599,lightgoldenrodyellow:16448210,lightgray:13882323,lightgreen:9498256,lightgrey:13882323,lightpink:16758465,lightsalmon:16752762,lightseagreen:2142890,lightskyblue:8900346,lightslategray:7833753,lightslategrey:7833753,lightsteelblue:11584734,lightyellow:16777184,lime:65280,limegreen:3329330,linen:16445670,magenta:16711935,maroon:8388608,mediumaquamarine:6737322,mediumblue:205,mediumorchid:12211667,mediumpurple:9662683,mediumseagreen:3978097,mediumslateblue:8087790,mediumspringgreen:64154,mediumturquoise:4772300,mediumvioletred:13047173,midnightblue:1644912,mintcream:16121850,mistyrose:16770273,moccasin:16770229,navajowhite:16768685,navy:128,oldlace:16643558,olive:8421376,olivedrab:7048739,orange:16753920,orangered:16729344,orchid:14315734,palegoldenrod:15657130,palegreen:10025880,paleturquoise:11529966,palevioletred:14381203,papayawhip:16773077,peachpuff:16767673,peru:13468991,pink:16761035,plum:14524637,powderblue:11591910,purple:8388736,rebeccapurple:6697881,red:16711680,rosybrown:12357519,royalblue:4286945,saddlebrown:9127187,salmon:16416882,sandybrown:16032864,seagreen:3050327,seashell:16774638,sienna:10506797,silver:12632256,skyblue:8900331,slateblue:6970061,slategray:7372944,slategrey:7372944,snow:16775930,springgreen:65407,steelblue:4620980,tan:13808780,teal:32896,thistle:14204888,tomato:16737095,turquoise:4251856,violet:15631086,wheat:16113331,white:16777215,whitesmoke:16119285,yellow:16776960,yellowgreen:10145074},gi={h:0,s:0,l:0},_i={h:0,s:0,l:0};function vi(e,t,n){return n<0&&(n+=1),n>1&&--n,n<1/6?e+(t-e)*6*n:n<1/2?t:n<2/3?e+(t-e)*6*(2/3-n):e}var Y=class{constructor(e,t,n){return this.isColor=!0,this.r=1,this.g=1,this.b=1,this.set(e,t,n)}set(e,t,n){if(t===void 0&&n===void 0){let t=e;t&&t.isColor?this.copy(t):typeof t==`number`?this.setHex(t):typeof t==`string`&&this.setStyle(t)}else this.setRGB(e,t,n);return this}setScalar(e){return this.r=e,this.g=e,this.b=e,this}setHex(e,t=Cn){return e=Math.floor(e),this.r=(e>>16&255)/255,this.g=(e>>8&255)/255,this.b=(e&255)/255,Sr.colorSpaceToWorking(this,t),this}setRGB(e,t,n,r=Sr.workingColorSpace){return this.r=e,this.g=t,this.b=n,Sr.colorSpaceToWorking(this,r),this}setHSL(e,t,n,r=Sr.workingColorSpace){if(e=qn(e,1),t=G(t,0,1),n=G(n,0,1),t===0)this.r=this.g=this.b=n;else{let r=n<=.5?n*(1+t):n+t-n*t,i=2*n-r;this.r=vi(i,r,e+1/3),this.g=vi(i,r,e),this.b=vi(i,r,e-1/3)}return Sr.colorSpaceToWorking(this,r),this}setStyle(e,t=Cn){function n(t){t!==void 0&&parseFloat(t)<1&&U(`Color: Alpha component of `+e+` will be ignored.`)}let r;if(r=/^(\w+)\(([^\)]*)\)/.exec(e)){let i,a=r[1],o=r[2];switch(a){case`rgb`:case`rgba`:if(i=/^\s*(\d+)\s*,\s*(\d+)\s*,\s*(\d+)\s*(?:,\s*(\d+(?:\.\d+)?|\.\d+)\s*)?$/.exec(o))return n(i[4]),this.setRGB(Math.min(255,parseInt(i[1],10))/255,Math.min(255,parseInt(i[2],10))/255,Math.min(255,parseInt(i[3],10))/255,t);if(i=/^\s*(\d+(?:\.\d+)?|\.\d+)\%\s*,\s*(\d+(?:\.\d+)?|\.\d+)\%\s*,\s*(\d+(?:\.\d+)?|\.\d+)\%\s*(?:,\s*(\d+(?:\.\d+)?|\.\d+)\s*)?$/.exec(o))return n(i[4]),this.setRGB(Math.min(100,parseFloat(i[1]))/100,Math.min(100,parseFloat(i[2]))/100,Math.min(100,parseFloat(i[3]))/100,t);break;case`hsl`:case`hsla`:if(i=/^\s*([+-]?(?:\d+(?:\.\d+)?|\.\d+))\s*,\s*(\d+(?:\.\d+)?|\.\d+)\%\s*,\s*(\d+(?:\.\d+)?|\.\d+)\%\s*(?:,\s*(\d+(?:\.\d+)?|\.\d+)\s*)?$/.exec(o))return n(i[4]),this.setHSL(parseFloat(i[1])/360,parseFloat(i[2])/100,parseFloat(i[3])/100,t);break;default:U(`Color: Unknown color model `+e)}}else if(r=/^\#([A-Fa-f\d]+)$/.exec(e)){let n=r[1],i=n.length;if(i===3)return this.setRGB(parseInt(n.charAt(0),16)/15,parseInt(n.charAt(1),16)/15,parseInt(n.charAt(2),16)/15,t);if(i===6)return this.setHex(parseInt(n,16),t);U(`Color: Invalid hex color `+e)}else if(e&&e.length>0)return this.setColorName(e,t);return this}setColorName(e,t=Cn){let n=hi[e.toLowerCase()];return n===void 0?U(`Color: Unknown color `+e):this.setHex(n,t),this}clone(){return new this.constructor(this.r,this.g,this.b)}copy(e){return this.r=e.r,this.g=e.g,this.b=e.b,this}copySRGBToLinear(e){return this.r=Cr(e.r),this.g=Cr(e.g),this.b=Cr(e.b),this}copyLinearToSRGB(e){return this.r=wr(e.r),this.g=wr(e.g),this.b=wr(e.b),this}convertSRGBToLinear(){return this.copySRGBToLinear(this),this}convertLinearToSRGB(){return this.copyLinearToSRGB(this),this}getHex(e=Cn){return Sr.workingToColorSpace(yi.copy(this),e),Math.round(G(yi.r*255,0,255))*65536+Math.round(G(yi.g*255,0,255))*256+Math.round(G(yi.b*255,0,255))}getHexString(e=Cn){return(`000000`+this.getHex(e).toString(16)).slice(-6)}getHSL(e,t=Sr.workingColorSpace){Sr.workingToColorSpace(yi.copy(this),t);let n=yi.r,r=yi.g,i=yi.b,a=Math.max(n,r,i),o=Math.min(n,r,i),s,c,l=(o+a)/2;if(o===a)s=0,c=0;else{let e=a-o;switch(c=l<=.5?e/(a+o):e/(2-a-o),a){case n:s=(r-i)/e+(r<i?6:0);break;case r:s=(i-n)/e+2;break;case i:s=(n-r)/e+4}s/=6}return e.h=s,e.s=c,e.l=l,e}getRGB(e,t=Sr.workingColorSpace){return Sr.workingToColorSpace(yi.copy(this),t),e.r=yi.r,e.g=yi.g,e.b=yi.b,e}getStyle(e=Cn){Sr.workingToColorSpace(yi.copy(this),e);let t=yi.r,n=yi.g,r=yi.b;return e===`srgb`?`rgb(${Math.round(t*255)},${Math.round(n*255)},${Math.round(r*255)})`:`color(${e} ${t.toFixed(3)} ${n.toFixed(3)} ${r.toFixed(3)})`}offsetHSL(e,t,n){return this.getHSL(gi),this.setHSL(gi.h+e,gi.s+t,gi.l+n)}add(e){return this.r+=e.r,this.g+=e.g,this.b+=e.b,this}addColors(e,t){return this.r=e.r+t.r,this.g=e.g+t.g,this.b=e.b+t.b,this}addScalar(e){return this.r+=e,this.g+=e,this.b+=e,this}sub(e){return this.r=Math.max(0,this.r-e.r),this.g=Math.max(0,this.g-e.g),this.b=Math.max(0,this.b-e.b),this}multiply(e){return this.r*=e.r,this.g*=e.g,this.b*=e.b,this}multiplyScalar(e){return this.r*=e,this.g*=e,this.b*=e,this}lerp(e,t){return this.r+=(e.r-this.r)*t,this.g+=(e.g-this.g)*t,this.b+=(e.b-this.b)*t,this}lerpColors(e,t,n){return this.r=e.r+(t.r-e.r)*n,this.g=e.g+(t.g-e.g)*n,this.b=e.b+(t.b-e.b)*n,this}lerpHSL(e,t){this.getHSL(gi),e.getHSL(_i);let n=Xn(gi.h,_i.h,t),r=Xn(gi.s,_i.s,t),i=Xn(gi.l,_i.l,t);return this.setHSL(n,r,i),this}setFromVector3(e){return this.r=e.x,this.g=e.y,this.b=e.z,this}applyMatrix3(e){let t=this.r,n=this.g,r=this.b,i=e.elements;return this.r=i[0]*t+i[3]*n+i[6]*r,this.g=i[1]*t+i[4]*n+i[7]*r,this.b=i[2]*t+i[5]*n+i[8]*r,this}equals(e){return e.r===this.r&&e.g===this.g&&e.b===this.b}fromArray(e,t=0){return this.r=e[t],this.g=e[t+1],this.b=e[t+2],this}toArray(e=[],t=0){return e[t]=this.r,e[t+1]=this.g,e[t+2]=this.b,e}fromBufferAttribute(e,t){return this.r=e.getX(t),this.g=e.getY(t),this.b=e.getZ(t),this}toJSON(){return this.getHex()}*[Symbol.iterator](){yield this.r,yield this.g,yield this.b}},yi=new Y;Y.NAMES=hi;var bi=class extends di{constructor(){super(),this.isScene=!0,this.type=`Scene`,this.background=null,this.environment=null,this.fog=null,this.backgroundBlurriness=0,this.backgroundIntensity=1,this.backgroundRotation=new Jr,this.environmentIntensity=1,this.environmentRotation=new Jr,this.overrideMaterial=null,typeof __THREE_DEVTOOLS__<`u`&&__THREE_DEVTOOLS__.dispatchEvent(new CustomEvent(`observe`,{detail:this}))}copy(e,t){return super.copy(e,t),this.background=e.background===null?null:e.background.clone(),this.environment=e.environment===null?null:e.environment.clone(),this.fog=e.fog===null?null:e.fog.clone(),this.backgroundBlurriness=e.backgroundBlurriness,this.backgroundIntensity=e.backgroundIntensity,this.backgroundRotation.copy(e.backgroundRotation),this.environmentIntensity=e.environmentIntensity,this.environmentRotation.copy(e.environmentRotation),this.overrideMaterial=e.overrideMaterial===null?null:e.overrideMaterial.clone(),this.matrixAutoUpdate=e.matrixAutoUpdate,this}toJSON(e){let t=super.toJSON(e);return this.fog!==null&&(t.object.fog=this.fog.toJSON()),t.object.backgroundBlurriness=this.backgroundBlurriness,t.object.backgroundIntensity=this.backgroundIntensity,t.object.backgroundRotation=this.backgroundRotation.toArray(),t.object.environmentIntensity=this.environmentIntensity,t.object.environmentRotation=this.environmentRotation.toArray(),t}},xi=new q,Si=new q,Ci=new q,wi=new q,Ti=new q,Ei=new q,Di=new q,Oi=new q,ki=new q,Ai=new q,ji=new Nr,Mi=new Nr,Ni=new Nr,Pi=class e{constructor(e=new q,t=new q,n=new q){this.a=e,this.b=t,this.c=n}static getNormal(e,t,n,r){r.subVectors(n,t),xi.subVectors(e,t),r.cross(xi);let i=r.lengthSq();return i>0?r.multiplyScalar(1/Math.sqrt(i)):r.set(0,0,0)}static getBarycoord(e,t,n,r,i){xi.subVectors(r,t),Si.subVectors(n,t),Ci.subVectors(e,t);let a=xi.dot(xi),o=xi.dot(Si),s=xi.dot(Ci),c=Si.dot(Si),l=Si.dot(Ci),u=a*c-o*o;if(u===0)return i.set(0,0,0),null;let d=1/u,f=(c*s-o*l)*d,p=(a*l-o*s)*d;return i.set(1-f-p,p,f)}static containsPoint(e,t,n,r){return this.getBarycoord(e,t,n,r,wi)!==null&&wi.x>=0&&wi.y>=0&&wi.x+wi.y<=1}static getInterpolation(e,t,n,r,i,a,o,s){return this.getBarycoord(e,t,n,r,wi)===null?(s.x=0,s.y=0,`z`in s&&(s.z=0),`w`in s&&(s.w=0),null):(s.setScalar(0),s.addScaledVector(i,wi.x),s.addScaledVector(a,wi.y),s.addScaledVector(o,wi.z),s)}static getInterpolatedAttribute(e,t,n,r,i,a){return ji.setScalar(0),Mi.setScalar(0),Ni.setScalar(0),ji.fromBufferAttribute(e,t),Mi.fromBufferAttribute(e,n),Ni.fromBufferAttribute(e,r),a.setScalar(0),a.addScaledVector(ji,i.x),a.addScaledVector(Mi,i.y),a.addScaledVector(Ni,i.z),a}static isFrontFacing(e,t,n,r){return xi.subVectors(n,t),Si.subVectors(e,t),xi.cross(Si).dot(r)<0}set(e,t,n){return this.a.copy(e),this.b.copy(t),this.c.copy(n),this}setFromPointsAndIndices(e,t,n,r){return this.a.copy(e[t]),this.b.copy(e[n]),this.c.copy(e[r]),this}setFromAttributeAndIndices(e,t,n,r){return this.a.fromBufferAttribute(e,t),this.b.fromBufferAttribute(e,n),this.c.fromBufferAttribute(e,r),this}clone(){return new this.constructor().copy(this)}copy(e){return this.a.copy(e.a),this.b.copy(e.b),this.c.copy(e.c),this}getArea(){return xi.subVectors(this.c,this.b),Si.subVectors(this.a,this.b),xi.cross(Si).length()*.5}getMidpoint(e){return e.addVectors(this.a,this.b).add(this.c).multiplyScalar(1/3)}getNormal(t){return e.getNormal(this.a,this.b,this.c,t)}getPlane(e){return e.setFromCoplanarPoints(this.a,this.b,this.c)}getBarycoord(t,n){return e.getBarycoord(t,this.a,this.b,this.c,n)}getInterpolation(t,n,r,i,a){return e.getInterpolation(t,this.a,this.b,this.c,n,r,i,a)}containsPoint(t){return e.containsPoint(t,this.a,this.b,this.c)}isFrontFacing(t){return e.isFrontFacing(this.a,this.b,this.c,t)}intersectsBox(e){return e.intersectsTriangle(this)}closestPointToPoint(e,t){let n=this.a,r=this.b,i=this.c,a,o;Ti.subVectors(r,n),Ei.subVectors(i,n),Oi.subVectors(e,n);let s=Ti.dot(Oi),c=Ei.dot(Oi);if(s<=0&&c<=0)return t.copy(n);ki.subVectors(e,r);let l=Ti.dot(ki),u=Ei.dot(ki);if(l>=0&&u<=l)return t.copy(r);let d=s*u-l*c;if(d<=0&&s>=0&&l<=0&&s-l>0)return a=s/(s-l),t.copy(n).addScaledVector(Ti,a);Ai.subVectors(e,i);let f=Ti.dot(Ai),p=Ei.dot(Ai);if(p>=0&&f<=p)return t.copy(i);let m=f*c-s*p;if(m<=0&&c>=0&&p<=0)return o=c/(c-p),t.copy(n).addScaledVector(Ei,o);let h=l*p-f*u;if(h<=0&&u-l>=0&&f-p>=0)return Di.subVectors(i,r),o=(u-l)/(u-l+(f-p)),t.copy(r).addScaledVector(Di,o);let g=1/(h+m+d);return a=m*g,o=d*g,t.copy(n).addScaledVector(Ti,a).addScaledVector(Ei,o)}equals(e){return e.a.equals(this.a)&&e.b.equals(this.b)&&e.c.equals(this.c)}},Fi=class{constructor(e=new q(1/0,1/0,1/0),t=new q(-1/0,-1/0,-1/0)){this.isBox3=!0,this.min=e,this.max=t}set(e,t){return this.min.copy(e),this.max.copy(t),this}setFromArray(e){this.makeEmpty();for(let t=0,n=e.length;t<n;t+=3)this.expandByPoint(Li.fromArray(e,t));return this}setFromBufferAttribute(e){this.makeEmpty();for(let t=0,n=e.count;t<n;t++)this.expandByPoint(Li.fromBufferAttribute(e,t));return this}setFromPoints(e){this.makeEmpty();for(let t=0,n=e.length;t<n;t++)this.expandByPoint(e[t]);return this}setFromCenterAndSize(e,t){let n=Li.copy(t).multiplyScalar(.5);return this.min.copy(e).sub(n),this.max.copy(e).add(n),this}setFromObject(e,t=!1){return this.makeEmpty(),this.expandByObject(e,t)}clone(){return new this.constructor().copy(this)}copy(e){return this.min.copy(e.min),this.max.copy(e.max),this}makeEmpty(){return this.min.x=this.min.y=this.min.z=1/0,this.max.x=this.max.y=this.max.z=-1/0,this}isEmpty(){return this.max.x<this.min.x||this.max.y<this.min.y||this.max.z<this.min.z}getCenter(e){return this.isEmpty()?e.set(0,0,0):e.addVectors(this.min,this.max).multiplyScalar(.5)}getSize(e){return this.isEmpty()?e.set(0,0,0):e.subVectors(this.max,this.min)}expandByPoint(e){return this.min.min(e),this.max.max(e),this}expandByVector(e){return this.min.sub(e),this.max.add(e),this}expandByScalar(e){return this.min.addScalar(-e),this.max.addScalar(e),this}expandByObject(e,t=!1){e.updateWorldMatrix(!1,!1);let n=e.geometry;if(n!==void 0){let r=n.getAttribute(`position`);if(t===!0&&r!==void 0&&e.isInstancedMesh!==!0&&e.isBatchedMesh!==!0)for(let t=0,n=r.count;t<n;t++)e.isMesh===!0?e.getVertexPosition(t,Li):Li.fromBufferAttribute(r,t),Li.applyMatrix4(e.matrixWorld),this.expandByPoint(Li);else e.boundingBox===void 0?(n.boundingBox===null&&n.computeBoundingBox(),Ri.copy(n.boundingBox)):(e.boundingBox===null&&e.computeBoundingBox(),Ri.copy(e.boundingBox)),Ri.applyMatrix4(e.matrixWorld),this.union(Ri)}let r=e.children;for(let e=0,n=r.length;e<n;e++)this.expandByObject(r[e],t);return this}containsPoint(e){return e.x>=this.min.x&&e.x<=this.max.x&&e.y>=this.min.y&&e.y<=this.max.y&&e.z>=this.min.z&&e.z<=this.max.z}containsBox(e){return this.min.x<=e.min.x&&e.max.x<=this.max.x&&this.min.y<=e.min.y&&e.max.y<=this.max.y&&this.min.z<=e.min.z&&e.max.z<=this.max.z}getParameter(e,t){return t.set((e.x-this.min.x)/(this.max.x-this.min.x),(e.y-this.min.y)/(this.max.y-this.min.y),(e.z-this.min.z)/(this.max.z-this.min.z))}intersectsBox(e){return e.max.x>=this.min.x&&e.min.x<=this.max.x&&e.max.y>=this.min.y&&e.min.y<=this.max.y&&e.max.z>=this.min.z&&e.min.z<=this.max.z}intersectsSphere(e){return this.clampPoint(e.center,Li),Li.distanceToSquared(e.center)<=e.radius*e.radius}intersectsPlane(e){let t,n;return e.normal.x>0?(t=e.normal.x*this.min.x,n=e.normal.x*this.max.x):(t=e.normal.x*this.max.x,n=e.normal.x*this.min.x),e.normal.y>0?(t+=e.normal.y*this.min.y,n+=e.normal.y*this.max.y):(t+=e.normal.y*this.max.y,n+=e.normal.y*this.min.y),e.normal.z>0?(t+=e.normal.z*this.min.z,n+=e.normal.z*this.max.z):(t+=e.normal.z*this.max.z,n+=e.normal.z*this.min.z),t<=-e.constant&&n>=-e.constant}intersectsTriangle(e){if(this.isEmpty())return!1;this.getCenter(Gi),Ki.subVectors(this.max,Gi),zi.subVectors(e.a,Gi),Bi.subVectors(e.b,Gi),Vi.subVectors(e.c,Gi),Hi.subVectors(Bi,zi),Ui.subVectors(Vi,Bi),Wi.subVectors(zi,Vi);let t=[0,-Hi.z,Hi.y,0,-Ui.z,Ui.y,0,-Wi.z,Wi.y,Hi.z,0,-Hi.x,Ui.z,0,-Ui.x,Wi.z,0,-Wi.x,-Hi.y,Hi.x,0,-Ui.y,Ui.x,0,-Wi.y,Wi.x,0];return!Yi(t,zi,Bi,Vi,Ki)||(t=[1,0,0,0,1,0,0,0,1],!Yi(t,zi,Bi,Vi,Ki))?!1:(qi.crossVectors(Hi,Ui),t=[qi.x,qi.y,qi.z],Yi(t,zi,Bi,Vi,Ki))}clampPoint(e,t){return t.copy(e).clamp(this.min,this.max)}distanceToPoint(e){return this.clampPoint(e,Li).distanceTo(e)}getBoundingSphere(e){return this.isEmpty()?e.makeEmpty():(this.getCenter(e.center),e.radius=this.getSize(Li).length()*.5),e}intersect(e){return this.min.max(e.min),this.max.min(e.max),this.isEmpty()&&this.makeEmpty(),this}union(e){return this.min.min(e.min),this.max.max(e.max),this}applyMatrix4(e){return this.isEmpty()||(Ii[0].set(this.min.x,this.min.y,this.min.z).applyMatrix4(e),Ii[1].set(this.min.x,this.min.y,this.max.z).applyMatrix4(e),Ii[2].set(this.min.x,this.max.y,this.min.z).applyMatrix4(e),Ii[3].set(this.min.x,this.max.y,this.max.z).applyMatrix4(e),Ii[4].set(this.max.x,this.min.y,this.min.z).applyMatrix4(e),Ii[5].set(this.max.x,this.min.y,this.max.z).applyMatrix4(e),Ii[6].set(this.max.x,this.max.y,this.min.z).applyMatrix4(e),Ii[7].set(this.max.x,this.max.y,this.max.z).applyMatrix4(e),this.setFromPoints(Ii)),this}translate(e){return this.min.add(e),this.max.add(e),this}equals(e){return e.min.equals(this.min)&&e.max.equals(this.max)}toJSON(){return{min:this.min.toArray(),max:this.max.toArray()}}fromJSON(e){return this.min.fromArray(e.min),this.max.fromArray(e.max),this}},Ii=[new q,new q,new q,new q,new q,new q,new q,new q],Li=new q,Ri=new Fi,zi=new q,Bi=new q,Vi=new q,Hi=new q,Ui=new q,Wi=new q,Gi=new q,Ki=new q,qi=new q,Ji=new q;function Yi(e,t,n,r,i){for(let a=0,o=e.length-3;a<=o;a+=3){Ji.fromArray(e,a);let o=i.x*Math.abs(Ji.x)+i.y*Math.abs(Ji.y)+i.z*Math.abs(Ji.z),s=t.dot(Ji),c=n.dot(Ji),l=r.dot(Ji);if(Math.max(-Math.max(s,c,l),Math.min(s,c,l))>o)return!1}return!0}var Xi=new q,Zi=new K,Qi=0,$i=class extends Vn{constructor(e,t,n=!1){if(super(),Array.isArray(e))throw TypeError(`THREE.BufferAttribute: array should be a Typed Array.`);this.isBufferAttribute=!0,Object.defineProperty(this,"id",{value:Qi++}),this.name=``,this.array=e,this.itemSize=t,this.count=e===void 0?0:e.length/t,this.normalized=n,this.usage=On,this.updateRanges=[],this.gpuType=ht,this.version=0,this._normalizationScale=e===void 0?void 0:dr(e)}onUploadCallback(){}set needsUpdate(e){e===!0&&this.version++}setUsage(e){return this.usage=e,this}addUpdateRange(e,t){this.updateRanges.push({start:e,count:t})}clearUpdateRanges(){this.updateRanges.length=0}copy(e){return this.name=e.name,this.array=new e.array.constructor(e.array),this.itemSize=e.itemSize,this.count=e.count,this.normalized=e.normalized,this.usage=e.usage,this.gpuType=e.gpuType,this._normalizationScale=e._normalizationScale,this}copyAt(e,t,n){e*=this.itemSize,n*=t.itemSize;for(let r=0,i=this.itemSize;r<i;r++)this.array[e+r]=t.array[n+r];return this}copyArray(e){return this.array.set(e),this}applyMatrix3(e){if(this.itemSize===2)for(let t=0,n=this.count;t<n;t++)Zi.fromBufferAttribute(this,t),Zi.applyMatrix3(e),this.setXY(t,Zi.x,Zi.y);else if(this.itemSize===3)for(let t=0,n=this.count;t<n;t++)Xi.fromBufferAttribute(this,t),Xi.applyMatrix3(e),this.setXYZ(t,Xi.x,Xi.y,Xi.z);return this}applyMatrix4(e){for(let t=0,n=this.count;t<n;t++)Xi.fromBufferAttribute(this,t),Xi.applyMatrix4(e),this.setXYZ(t,Xi.x,Xi.y,Xi.z);return this}applyNormalMatrix(e){for(let t=0,n=this.count;t<n;t++)Xi.fromBufferAttribute(this,t),Xi.applyNormalMatrix(e),this.setXYZ(t,Xi.x,Xi.y,Xi.z);return this}transformDirection(e){for(let t=0,n=this.count;t<n;t++)Xi.fromBufferAttribute(this,t),Xi.transformDirection(e),this.setXYZ(t,Xi.x,Xi.y,Xi.z);return this}set(e,t=0){return this.array.set(e,t),this}getComponent(e,t){let n=this.array[e*this.itemSize+t];return this.normalized&&(n=this._denormalize(n)),n}setComponent(e,t,n){return this.normalized&&(n=this._normalize(n)),this.array[e*this.itemSize+t]=n,this}getX(e){let t=this.array[e*this.itemSize];return this.normalized&&(t=this._denormalize(t)),t}setX(e,t){return this.normalized&&(t=this._normalize(t)),this.array[e*this.itemSize]=t,this}getY(e){let t=this.array[e*this.itemSize+1];return this.normalized&&(t=this._denormalize(t)),t}setY(e,t){return this.normalized&&(t=this._normalize(t)),this.array[e*this.itemSize+1]=t,this}getZ(e){let t=this.array[e*this.itemSize+2];return this.normalized&&(t=this._denormalize(t)),t}setZ(e,t){return this.normalized&&(t=this._normalize(t)),this.array[e*this.itemSize+2]=t,this}getW(e){let t=this.array[e*this.itemSize+3];return this.normalized&&(t=this._denormalize(t)),t}setW(e,t){return this.normalized&&(t=this._normalize(t)),this.array[e*this.itemSize+3]=t,this}setXY(e,t,n){return e*=this.itemSize,this.normalized&&(t=this._normalize(t),n=this._normalize(n)),this.array[e+0]=t,this.array[e+1]=n,this}setXYZ(e,t,n,r){return e*=this.itemSize,this.normalized&&(t=this._normalize(t),n=this._normalize(n),r=this._normalize(r)),this.array[e+0]=t,this.array[e+1]=n,this.array[e+2]=r,this}setXYZW(e,t,n,r,i){return e*=this.itemSize,this.normalized&&(t=this._normalize(t),n=this._normalize(n),r=this._normalize(r),i=this._normalize(i)),this.array[e+0]=t,this.array[e+1]=n,this.array[e+2]=r,this.array[e+3]=i,this}onUpload(e){return this.onUploadCallback=e,this}clone(){return new this.constructor(this.array,this.itemSize).copy(this)}toJSON(){let e={itemSize:this.itemSize,type:this.array.constructor.name,array:Array.from(this.array),normalized:this.normalized};return e.name=this.name,e.usage=this.usage,e.gpuType=this.gpuType,e}dispose(){this.dispatchEvent({type:`dispose`})}_denormalize(e){let t=this._normalizationScale;return t===void 0?fr(e,this.array):Math.max(e/t,-1)}_normalize(e){let t=this._normalizationScale;return t===void 0?pr(e,this.array):Math.round(e*t)}},ea=class extends $i{constructor(e,t,n){super(new Uint16Array(e),t,n)}},ta=class extends $i{constructor(e,t,n){super(new Uint32Array(e),t,n)}},na=class extends $i{constructor(e,t,n){super(new Float32Array(e),t,n)}},ra=new Fi,ia=new q,aa=new q,oa=class{constructor(e=new q,t=-1){this.isSphere=!0,this.center=e,this.radius=t}set(e,t){return this.center.copy(e),this.radius=t,this}setFromPoints(e,t){let n=this.center;t===void 0?ra.setFromPoints(e).getCenter(n):n.copy(t);let r=0;for(let t=0,i=e.length;t<i;t++)r=Math.max(r,n.distanceToSquared(e[t]));return this.radius=Math.sqrt(r),this}copy(e){return this.center.copy(e.center),this.radius=e.radius,this}isEmpty(){return this.radius<0}makeEmpty(){return this.center.set(0,0,0),this.radius=-1,this}containsPoint(e){return e.distanceToSquared(this.center)<=this.radius*this.radius}distanceToPoint(e){return e.distanceTo(this.center)-this.radius}intersectsSphere(e){let t=this.radius+e.radius;return e.center.distanceToSquared(this.center)<=t*t}intersectsBox(e){return e.intersectsSphere(this)}intersectsPlane(e){return Math.abs(e.distanceToPoint(this.center))<=this.radius}clampPoint(e,t){let n=this.center.distanceToSquared(e);return t.copy(e),n>this.radius*this.radius&&(t.sub(this.center).normalize(),t.multiplyScalar(this.radius).add(this.center)),t}getBoundingBox(e){return this.isEmpty()?(e.makeEmpty(),e):(e.set(this.center,this.center),e.expandByScalar(this.radius),e)}applyMatrix4(e){return this.center.applyMatrix4(e),this.radius*=e.getMaxScaleOnAxis(),this}translate(e){return this.center.add(e),this}expandByPoint(e){if(this.isEmpty())return this.center.copy(e),this.radius=0,this;ia.subVectors(e,this.center);let t=ia.lengthSq();if(t>this.radius*this.radius){let e=Math.sqrt(t),n=(e-this.radius)*.5;this.center.addScaledVector(ia,n/e),this.radius+=n}return this}union(e){return e.isEmpty()?this:this.isEmpty()?(this.copy(e),this):(this.center.equals(e.center)===!0?this.radius=Math.max(this.radius,e.radius):(aa.subVectors(e.center,this.center).setLength(e.radius),this.expandByPoint(ia.copy(e.center).add(aa)),this.expandByPoint(ia.copy(e.center).sub(aa))),this)}equals(e){return e.center.equals(this.center)&&e.radius===this.radius}clone(){return new this.constructor().copy(this)}toJSON(){return{radius:this.radius,center:this.center.toArray()}}fromJSON(e){return this.radius=e.radius,this.center.fromArray(e.center),this}},sa=0,ca=new Rr,la=new di,ua=new q,da=new Fi,fa=new Fi,pa=new q,ma=class e extends Vn{constructor(){super(),this.isBufferGeometry=!0,Object.defineProperty(this,"id",{value:sa++}),this.uuid=Kn(),this.name=``,this.type=`BufferGeometry`,this.index=null,this.indirect=null,this.indirectOffset=0,this.attributes={},this.morphAttributes={},this.morphTargetsRelative=!1,this.groups=[],this.boundingBox=null,this.boundingSphere=null,this.drawRange={start:0,count:1/0},this.userData={},this._transformed=!1}getIndex(){return this.index}setIndex(e){return this.index=Array.isArray(e)?new(jn(e)?ta:ea)(e,1):e,this}setIndirect(e,t=0){return this.indirect=e,this.indirectOffset=t,this}getIndirect(){return this.indirect}getAttribute(e){return this.attributes[e]}setAttribute(e,t){return this.attributes[e]=t,this}deleteAttribute(e){return delete this.attributes[e],this}hasAttribute(e){return this.attributes[e]!==void 0}addGroup(e,t,n=0){this.groups.push({start:e,count:t,materialIndex:n})}clearGroups(){this.groups=[]}setDrawRange(e,t){this.drawRange.start=e,this.drawRange.count=t}applyMatrix4(e){let t=this.attributes.position;t!==void 0&&(t.applyMatrix4(e),t.needsUpdate=!0);let n=this.attributes.normal;if(n!==void 0){let t=new J().getNormalMatrix(e);n.applyNormalMatrix(t),n.needsUpdate=!0}let r=this.attributes.tangent;return r!==void 0&&(r.transformDirection(e),r.needsUpdate=!0),this.boundingBox!==null&&this.computeBoundingBox(),this.boundingSphere!==null&&this.computeBoundingSphere(),this._transformed=!0,this}applyQuaternion(e){return ca.makeRotationFromQuaternion(e),this.applyMatrix4(ca),this}rotateX(e){return ca.makeRotationX(e),this.applyMatrix4(ca),this}rotateY(e){return ca.makeRotationY(e),this.applyMatrix4(ca),this}rotateZ(e){return ca.makeRotationZ(e),this.applyMatrix4(ca),this}translate(e,t,n){return ca.makeTranslation(e,t,n),this.applyMatrix4(ca),this}scale(e,t,n){return ca.makeScale(e,t,n),this.applyMatrix4(ca),this}lookAt(e){return la.lookAt(e),la.updateMatrix(),this.applyMatrix4(la.matrix),this}center(){return this.computeBoundingBox(),this.boundingBox.getCenter(ua).negate(),this.translate(ua.x,ua.y,ua.z),this}setFromPoints(e){let t=this.getAttribute(`position`);if(t===void 0){let t=[];for(let n=0,r=e.length;n<r;n++){let r=e[n];t.push(r.x,r.y,r.z||0)}this.setAttribute(`position`,new na(t,3))}else{let n=Math.min(e.length,t.count);for(let r=0;r<n;r++){let n=e[r];t.setXYZ(r,n.x,n.y,n.z||0)}e.length>t.count&&U(`BufferGeometry: Buffer size too small for points data. Use .dispose() and create a new geometry.`),t.needsUpdate=!0}return this}computeBoundingBox(){this.boundingBox===null&&(this.boundingBox=new Fi);let e=this.attributes.position,t=this.morphAttributes.position;if(e&&e.isGLBufferAttribute)W(`BufferGeometry.computeBoundingBox(): GLBufferAttribute requires a manual bounding box.`,this),this.boundingBox.set(new q(-1/0,-1/0,-1/0),new q(1/0,1/0,1/0));else{if(e!==void 0){if(this.boundingBox.setFromBufferAttribute(e),t)for(let e=0,n=t.length;e<n;e++){let n=t[e];da.setFromBufferAttribute(n),this.morphTargetsRelative?(pa.addVectors(this.boundingBox.min,da.min),this.boundingBox.expandByPoint(pa),pa.addVectors(this.boundingBox.max,da.max),this.boundingBox.expandByPoint(pa)):(this.boundingBox.expandByPoint(da.min),this.boundingBox.expandByPoint(da.max))}}else this.boundingBox.makeEmpty();(isNaN(this.boundingBox.min.x)||isNaN(this.boundingBox.min.y)||isNaN(this.boundingBox.min.z))&&W(`BufferGeometry.computeBoundingBox(): Computed min/max have NaN values. The "position" attribute is likely to have NaN values.`,this)}}computeBoundingSphere(){this.boundingSphere===null&&(this.boundingSphere=new oa);let e=this.attributes.position,t=this.morphAttributes.position;if(e&&e.isGLBufferAttribute)W(`BufferGeometry.computeBoundingSphere(): GLBufferAttribute requires a manual bounding sphere.`,this),this.boundingSphere.set(new q,1/0);else if(e){let n=this.boundingSphere.center;if(da.setFromBufferAttribute(e),t)for(let e=0,n=t.length;e<n;e++){let n=t[e];fa.setFromBufferAttribute(n),this.morphTargetsRelative?(pa.addVectors(da.min,fa.min),da.expandByPoint(pa),pa.addVectors(da.max,fa.max),da.expandByPoint(pa)):(da.expandByPoint(fa.min),da.expandByPoint(fa.max))}da.getCenter(n);let r=0;for(let t=0,i=e.count;t<i;t++)pa.fromBufferAttribute(e,t),r=Math.max(r,n.distanceToSquared(pa));if(t)for(let i=0,a=t.length;i<a;i++){let a=t[i],o=this.morphTargetsRelative;for(let t=0,i=a.count;t<i;t++)pa.fromBufferAttribute(a,t),o&&(ua.fromBufferAttribute(e,t),pa.add(ua)),r=Math.max(r,n.distanceToSquared(pa))}this.boundingSphere.radius=Math.sqrt(r),isNaN(this.boundingSphere.radius)&&W(`BufferGeometry.computeBoundingSphere(): Computed radius is NaN. The "position" attribute is likely to have NaN values.`,this)}}computeTangents(){let e=this.index,t=this.attributes;if(e===null||t.position===void 0||t.normal===void 0||t.uv===void 0){W(`BufferGeometry: .computeTangents() failed. Missing required attributes (index, position, normal or uv)`);return}let n=t.position,r=t.normal,i=t.uv,a=this.getAttribute(`tangent`);(a===void 0||a.count!==n.count)&&(a=new $i(new Float32Array(4*n.count),4),this.setAttribute(`tangent`,a));let o=[],s=[],c=new Uint8Array(n.count);for(let e=0;e<n.count;e++)o[e]=new q,s[e]=new q;let l=new q,u=new q,d=new q,f=new K,p=new K,m=new K,h=new q,g=new q;function _(e,t,r){c[e]=c[t]=c[r]=1,l.fromBufferAttribute(n,e),u.fromBufferAttribute(n,t),d.fromBufferAttribute(n,r),f.fromBufferAttribute(i,e),p.fromBufferAttribute(i,t),m.fromBufferAttribute(i,r),u.sub(l),d.sub(l),p.sub(f),m.sub(f);let a=1/(p.x*m.y-m.x*p.y);isFinite(a)&&(h.copy(u).multiplyScalar(m.y).addScaledVector(d,-p.y).multiplyScalar(a),g.copy(d).multiplyScalar(p.x).addScaledVector(u,-m.x).multiplyScalar(a),o[e].add(h),o[t].add(h),o[r].add(h),s[e].add(g),s[t].add(g),s[r].add(g))}let v=this.groups;v.length===0&&(v=[{start:0,count:e.count}]);for(let t=0,n=v.length;t<n;++t){let n=v[t],r=n.start,i=n.count;for(let t=r,n=r+i;t<n;t+=3)_(e.getX(t+0),e.getX(t+1),e.getX(t+2))}let y=new q,b=new q,x=new q,S=new q;function C(e){x.fromBufferAttribute(r,e),S.copy(x);let t=o[e];y.copy(t),y.sub(x.multiplyScalar(x.dot(t))).normalize(),b.crossVectors(S,t);let n=b.dot(s[e])<0?-1:1;a.setXYZW(e,y.x,y.y,y.z,n)}for(let e=0,t=n.count;e<t;++e)c[e]&&C(e);this._transformed=!0}computeVertexNormals(){let e=this.index,t=this.getAttribute(`position`);if(t!==void 0){let n=this.getAttribute(`normal`);if(n===void 0||n.count!==t.count)n=new $i(new Float32Array(t.count*3),3),this.setAttribute(`normal`,n);else for(let e=0,t=n.count;e<t;e++)n.setXYZ(e,0,0,0);let r=new q,i=new q,a=new q,o=new q,s=new q,c=new q,l=new q,u=new q;if(e)for(let d=0,f=e.count;d<f;d+=3){let f=e.getX(d+0),p=e.getX(d+1),m=e.getX(d+2);r.fromBufferAttribute(t,f),i.fromBufferAttribute(t,p),a.fromBufferAttribute(t,m),l.subVectors(a,i),u.subVectors(r,i),l.cross(u),o.fromBufferAttribute(n,f),s.fromBufferAttribute(n,p),c.fromBufferAttribute(n,m),o.add(l),s.add(l),c.add(l),n.setXYZ(f,o.x,o.y,o.z),n.setXYZ(p,s.x,s.y,s.z),n.setXYZ(m,c.x,c.y,c.z)}else for(let e=0,o=t.count;e<o;e+=3)r.fromBufferAttribute(t,e+0),i.fromBufferAttribute(t,e+1),a.fromBufferAttribute(t,e+2),l.subVectors(a,i),u.subVectors(r,i),l.cross(u),n.setXYZ(e+0,l.x,l.y,l.z),n.setXYZ(e+1,l.x,l.y,l.z),n.setXYZ(e+2,l.x,l.y,l.z);this.normalizeNormals(),n.needsUpdate=!0}}normalizeNormals(){let e=this.attributes.normal;for(let t=0,n=e.count;t<n;t++)pa.fromBufferAttribute(e,t),pa.normalize(),e.setXYZ(t,pa.x,pa.y,pa.z)}toNonIndexed(){function t(e,t){let n=e.array,r=e.itemSize,i=e.normalized,a=new n.constructor(t.length*r),o=0,s=0;for(let i=0,c=t.length;i<c;i++){o=e.isInterleavedBufferAttribute?t[i]*e.data.stride+e.offset:t[i]*r;for(let e=0;e<r;e++)a[s++]=n[o++]}return new $i(a,r,i)}if(this.index===null)return U(`BufferGeometry.toNonIndexed(): BufferGeometry is already non-indexed.`),this;let n=new e,r=this.index.array,i=this.attributes;for(let e in i){let a=i[e],o=t(a,r);n.setAttribute(e,o)}let a=this.morphAttributes;for(let e in a){let i=[],o=a[e];for(let e=0,n=o.length;e<n;e++){let n=o[e],a=t(n,r);i.push(a)}n.morphAttributes[e]=i}n.morphTargetsRelative=this.morphTargetsRelative;let o=this.groups;for(let e=0,t=o.length;e<t;e++){let t=o[e];n.addGroup(t.start,t.count,t.materialIndex)}return n}toJSON(){let e={metadata:{version:4.7,type:`BufferGeometry`,generator:`BufferGeometry.toJSON`}};if(e.uuid=this.uuid,e.type=this.parameters!==void 0&&this._transformed===!0?`BufferGeometry`:this.type,e.name=this.name,Object.keys(this.userData).length>0&&(e.userData=this.userData),this.parameters!==void 0&&this._transformed!==!0){let t=this.parameters;for(let n in t)t[n]!==void 0&&(e[n]=t[n]);return e}e.data={attributes:{}};let t=this.index;t!==null&&(e.data.index={type:t.array.constructor.name,array:Array.prototype.slice.call(t.array)});let n=this.attributes;for(let t in n){let r=n[t];e.data.attributes[t]=r.toJSON(e.data)}let r={},i=!1;for(let t in this.morphAttributes){let n=this.morphAttributes[t],a=[];for(let t=0,r=n.length;t<r;t++){let r=n[t];a.push(r.toJSON(e.data))}a.length>0&&(r[t]=a,i=!0)}i&&(e.data.morphAttributes=r,e.data.morphTargetsRelative=this.morphTargetsRelative);let a=this.groups;a.length>0&&(e.data.groups=JSON.parse(JSON.stringify(a)));let o=this.boundingSphere;return o!==null&&(e.data.boundingSphere=o.toJSON()),e}clone(){return new this.constructor().copy(this)}copy(e){this.index=null,this.attributes={},this.morphAttributes={},this.groups=[],this.boundingBox=null,this.boundingSphere=null;let t={};this.name=e.name;let n=e.index;n!==null&&this.setIndex(n.clone());let r=e.attributes;for(let e in r){let n=r[e];this.setAttribute(e,n.clone(t))}let i=e.morphAttributes;for(let e in i){let n=[],r=i[e];for(let e=0,i=r.length;e<i;e++)n.push(r[e].clone(t));this.morphAttributes[e]=n}this.morphTargetsRelative=e.morphTargetsRelative;let a=e.groups;for(let e=0,t=a.length;e<t;e++){let t=a[e];this.addGroup(t.start,t.count,t.materialIndex)}let o=e.boundingBox;o!==null&&(this.boundingBox=o.clone());let s=e.boundingSphere;return s!==null&&(this.boundingSphere=s.clone()),this.drawRange.start=e.drawRange.start,this.drawRange.count=e.drawRange.count,this.userData=e.userData,this._transformed=e._transformed,this}dispose(){this.dispatchEvent({type:`dispose`})}},ha=class{constructor(e,t){this.isInterleavedBuffer=!0,this.array=e,this.stride=t,this.count=e===void 0?0:e.length/t,this.usage=On,this.updateRanges=[],this.version=0,this.uuid=Kn()}onUploadCallback(){}set needsUpdate(e){e===!0&&this.version++}setUsage(e){return this.usage=e,this}addUpdateRange(e,t){this.updateRanges.push({start:e,count:t})}clearUpdateRanges(){this.updateRanges.length=0}copy(e){return this.array=new e.array.constructor(e.array),this.count=e.count,this.stride=e.stride,this.usage=e.usage,this}copyAt(e,t,n){e*=this.stride,n*=t.stride;for(let r=0,i=this.stride;r<i;r++)this.array[e+r]=t.array[n+r];return this}set(e,t=0){return this.array.set(e,t),this}clone(e){e.arrayBuffers===void 0&&(e.arrayBuffers={});let t=ga(this.array);e.arrayBuffers[t]===void 0&&(e.arrayBuffers[t]=this.array.slice(0).buffer);let n=new this.array.constructor(e.arrayBuffers[t]),r=new this.constructor(n,this.stride);return r.setUsage(this.usage),r}onUpload(e){return this.onUploadCallback=e,this}toJSON(e){e.arrayBuffers===void 0&&(e.arrayBuffers={});let t=ga(this.array);e.arrayBuffers[t]===void 0&&(e.arrayBuffers[t]=Array.from(new Uint32Array(this.array.slice(0).buffer)));let n={uuid:this.uuid,buffer:t,type:this.array.constructor.name,stride:this.stride};return n.usage=this.usage,n}};function ga(e){return e.buffer._uuid===void 0&&(e.buffer._uuid=Kn()),e.byteOffset===0&&e.byteLength===e.buffer.byteLength?e.buffer._uuid:e.buffer._uuid+`:`+e.byteOffset+`:`+e.byteLength}var _a=new q,va=class e{constructor(e,t,n,r=!1){this.isInterleavedBufferAttribute=!0,this.name=``,this.data=e,this.itemSize=t,this.offset=n,this.normalized=r,this._normalizationScale=e===void 0?void 0:dr(e.array)}get count(){return this.data.count}get array(){return this.data.array}set needsUpdate(e){this.data.needsUpdate=e}applyMatrix4(e){for(let t=0,n=this.data.count;t<n;t++)_a.fromBufferAttribute(this,t),_a.applyMatrix4(e),this.setXYZ(t,_a.x,_a.y,_a.z);return this}applyNormalMatrix(e){for(let t=0,n=this.count;t<n;t++)_a.fromBufferAttribute(this,t),_a.applyNormalMatrix(e),this.setXYZ(t,_a.x,_a.y,_a.z);return this}transformDirection(e){for(let t=0,n=this.count;t<n;t++)_a.fromBufferAttribute(this,t),_a.transformDirection(e),this.setXYZ(t,_a.x,_a.y,_a.z);return this}getComponent(e,t){let n=this.array[e*this.data.stride+this.offset+t];return this.normalized&&(n=this._denormalize(n)),n}setComponent(e,t,n){return this.normalized&&(n=this._normalize(n)),this.data.array[e*this.data.stride+this.offset+t]=n,this}setX(e,t){return this.normalized&&(t=this._normalize(t)),this.data.array[e*this.data.stride+this.offset]=t,this}setY(e,t){return this.normalized&&(t=this._normalize(t)),this.data.array[e*this.data.stride+this.offset+1]=t,this}setZ(e,t){return this.normalized&&(t=this._normalize(t)),this.data.array[e*this.data.stride+this.offset+2]=t,this}setW(e,t){return this.normalized&&(t=this._normalize(t)),this.data.array[e*this.data.stride+this.offset+3]=t,this}getX(e){let t=this.data.array[e*this.data.stride+this.offset];return this.normalized&&(t=this._denormalize(t)),t}getY(e){let t=this.data.array[e*this.data.stride+this.offset+1];return this.normalized&&(t=this._denormalize(t)),t}getZ(e){let t=this.data.array[e*this.data.stride+this.offset+2];return this.normalized&&(t=this._denormalize(t)),t}getW(e){let t=this.data.array[e*this.data.stride+this.offset+3];return this.normalized&&(t=this._denormalize(t)),t}setXY(e,t,n){return e=e*this.data.stride+this.offset,this.normalized&&(t=this._normalize(t),n=this._normalize(n)),this.data.array[e+0]=t,this.data.array[e+1]=n,this}setXYZ(e,t,n,r){return e=e*this.data.stride+this.offset,this.normalized&&(t=this._normalize(t),n=this._normalize(n),r=this._normalize(r)),this.data.array[e+0]=t,this.data.array[e+1]=n,this.data.array[e+2]=r,this}setXYZW(e,t,n,r,i){return e=e*this.data.stride+this.offset,this.normalized&&(t=this._normalize(t),n=this._normalize(n),r=this._normalize(r),i=this._normalize(i)),this.data.array[e+0]=t,this.data.array[e+1]=n,this.data.array[e+2]=r,this.data.array[e+3]=i,this}clone(t){if(t===void 0){In(`InterleavedBufferAttribute.clone(): Cloning an interleaved buffer attribute will de-interleave buffer data.`);let e=[];for(let t=0;t<this.count;t++){let n=t*this.data.stride+this.offset;for(let t=0;t<this.itemSize;t++)e.push(this.data.array[n+t])}return new $i(new this.array.constructor(e),this.itemSize,this.normalized)}return t.interleavedBuffers===void 0&&(t.interleavedBuffers={}),t.interleavedBuffers[this.data.uuid]===void 0&&(t.interleavedBuffers[this.data.uuid]=this.data.clone(t)),new e(t.interleavedBuffers[this.data.uuid],this.itemSize,this.offset,this.normalized)}toJSON(e){if(e===void 0){In(`InterleavedBufferAttribute.toJSON(): Serializing an interleaved buffer attribute will de-interleave buffer data.`);let e=[];for(let t=0;t<this.count;t++){let n=t*this.data.stride+this.offset;for(let t=0;t<this.itemSize;t++)e.push(this.data.array[n+t])}return{itemSize:this.itemSize,type:this.array.constructor.name,array:e,normalized:this.normalized}}return e.interleavedBuffers===void 0&&(e.interleavedBuffers={}),e.interleavedBuffers[this.data.uuid]===void 0&&(e.interleavedBuffers[this.data.uuid]=this.data.toJSON(e)),{isInterleavedBufferAttribute:!0,itemSize:this.itemSize,data:this.data.uuid,offset:this.offset,normalized:this.normalized}}_denormalize(e){let t=this._normalizationScale;return t===void 0?fr(e,this.data.array):Math.max(e/t,-1)}_normalize(e){let t=this._normalizationScale;return t===void 0?pr(e,this.data.array):Math.round(e*t)}},ya=new q,ba=new q,xa=new J,Sa=class{constructor(e=new q(1,0,0),t=0){this.isPlane=!0,this.normal=e,this.constant=t}set(e,t){return this.normal.copy(e),this.constant=t,this}setComponents(e,t,n,r){return this.normal.set(e,t,n),this.constant=r,this}setFromNormalAndCoplanarPoint(e,t){return this.normal.copy(e),this.constant=-t.dot(this.normal),this}setFromCoplanarPoints(e,t,n){let r=ya.subVectors(n,t).cross(ba.subVectors(e,t)).normalize();return this.setFromNormalAndCoplanarPoint(r,e),this}copy(e){return this.normal.copy(e.normal),this.constant=e.constant,this}normalize(){let e=1/this.normal.length();return this.normal.multiplyScalar(e),this.constant*=e,this}negate(){return this.constant*=-1,this.normal.negate(),this}distanceToPoint(e){return this.normal.dot(e)+this.constant}distanceToSphere(e){return this.distanceToPoint(e.center)-e.radius}projectPoint(e,t){return t.copy(e).addScaledVector(this.normal,-this.distanceToPoint(e))}intersectLine(e,t,n=!0){let r=e.delta(ya),i=this.normal.dot(r);if(i===0)return this.distanceToPoint(e.start)===0?t.copy(e.start):null;let a=-(e.start.dot(this.normal)+this.constant)/i;return n===!0&&(a<0||a>1)?null:t.copy(e.start).addScaledVector(r,a)}intersectsLine(e){let t=this.distanceToPoint(e.start),n=this.distanceToPoint(e.end);return t<0&&n>0||n<0&&t>0}intersectsBox(e){return e.intersectsPlane(this)}intersectsSphere(e){return e.intersectsPlane(this)}coplanarPoint(e){return e.copy(this.normal).multiplyScalar(-this.constant)}applyMatrix4(e,t){let n=t||xa.getNormalMatrix(e),r=this.coplanarPoint(ya).applyMatrix4(e),i=this.normal.applyMatrix3(n).normalize();return this.constant=-r.dot(i),this}translate(e){return this.constant-=e.dot(this.normal),this}equals(e){return e.normal.equals(this.normal)&&e.constant===this.constant}clone(){return new this.constructor().copy(this)}toJSON(){return{normal:this.normal.toArray(),constant:this.constant}}fromJSON(e){return this.normal.fromArray(e.normal),this.constant=e.constant,this}},Ca=0,wa=class extends Vn{constructor(){super(),this.isMaterial=!0,Object.defineProperty(this,"id",{value:Ca++}),this.uuid=Kn(),this.name=``,this.type=`Material`,this.blending=1,this.side=0,this.vertexColors=!1,this.opacity=1,this.transparent=!1,this.alphaHash=!1,this.blendSrc=204,this.blendDst=205,this.blendEquation=100,this.blendSrcAlpha=null,this.blendDstAlpha=null,this.blendEquationAlpha=null,this.blendColor=new Y(0,0,0),this.blendAlpha=0,this.depthFunc=3,this.depthTest=!0,this.depthWrite=!0,this.stencilWriteMask=255,this.stencilFunc=519,this.stencilRef=0,this.stencilFuncMask=255,this.stencilFail=Dn,this.stencilZFail=Dn,this.stencilZPass=Dn,this.stencilWrite=!1,this.clippingPlanes=null,this.clipIntersection=!1,this.clipShadows=!1,this.shadowSide=null,this.colorWrite=!0,this.precision=null,this.polygonOffset=!1,this.polygonOffsetFactor=0,this.polygonOffsetUnits=0,this.dithering=!1,this.alphaToCoverage=!1,this.premultipliedAlpha=!1,this.forceSinglePass=!1,this.allowOverride=!0,this.visible=!0,this.toneMapped=!0,this.userData={},this.version=0,this._alphaTest=0}get alphaTest(){return this._alphaTest}set alphaTest(e){this._alphaTest>0!=e>0&&this.version++,this._alphaTest=e}onBeforeRender(){}onBeforeCompile(){}customProgramCacheKey(){return this.onBeforeCompile.toString()}setValues(e){if(e!==void 0)for(let t in e){let n=e[t];if(n===void 0){U(`Material: parameter '${t}' has value of undefined.`);continue}let r=this[t];r===void 0?U(`Material: '${t}' is not a property of THREE.${this.type}.`):r&&r.isColor?r.set(n):r&&r.isVector2&&n&&n.isVector2||r&&r.isEuler&&n&&n.isEuler||r&&r.isVector3&&n&&n.isVector3?r.copy(n):this[t]=n}}toJSON(e){let t=e===void 0||typeof e==`string`;t&&(e={textures:{},images:{}});let n={metadata:{version:4.7,type:`Material`,generator:`Material.toJSON`}};n.uuid=this.uuid,n.type=this.type,n.blending=this.blending,n.side=this.side,n.shadowSide=this.shadowSide,n.vertexColors=this.vertexColors,n.opacity=this.opacity,n.transparent=this.transparent,n.blendSrc=this.blendSrc,n.blendDst=this.blendDst,n.blendEquation=this.blendEquation,n.blendSrcAlpha=this.blendSrcAlpha,n.blendDstAlpha=this.blendDstAlpha,n.blendEquationAlpha=this.blendEquationAlpha,n.blendColor=this.blendColor.getHex(),n.blendAlpha=this.blendAlpha,n.depthFunc=this.depthFunc,n.depthTest=this.depthTest,n.depthWrite=this.depthWrite,n.colorWrite=this.colorWrite,n.clipIntersection=this.clipIntersection,n.clipShadows=this.clipShadows,n.stencilWriteMask=this.stencilWriteMask,n.stencilFunc=this.stencilFunc,n.stencilRef=this.stencilRef,n.stencilFuncMask=this.stencilFuncMask,n.stencilFail=this.stencilFail,n.stencilZFail=this.stencilZFail,n.stencilZPass=this.stencilZPass,n.stencilWrite=this.stencilWrite,n.polygonOffset=this.polygonOffset,n.polygonOffsetFactor=this.polygonOffsetFactor,n.polygonOffsetUnits=this.polygonOffsetUnits,n.dithering=this.dithering,n.alphaTest=this.alphaTest,n.alphaHash=this.alphaHash,n.alphaToCoverage=this.alphaToCoverage,n.premultipliedAlpha=this.premultipliedAlpha,n.forceSinglePass=this.forceSinglePass,n.allowOverride=this.allowOverride,n.visible=this.visible,n.toneMapped=this.toneMapped,n.name=this.name,this.color&&this.color.isColor&&(n.color=this.color.getHex()),this.roughness!==void 0&&(n.roughness=this.roughness),this.metalness!==void 0&&(n.metalness=this.metalness),this.sheen!==void 0&&(n.sheen=this.sheen),this.sheenColor&&this.sheenColor.isColor&&(n.sheenColor=this.sheenColor.getHex()),this.sheenRoughness!==void 0&&(n.sheenRoughness=this.sheenRoughness),this.emissive&&this.emissive.isColor&&(n.emissive=this.emissive.getHex()),this.emissiveIntensity!==void 0&&(n.emissiveIntensity=this.emissiveIntensity),this.specular&&this.specular.isColor&&(n.specular=this.specular.getHex()),this.specularIntensity!==void 0&&(n.specularIntensity=this.specularIntensity),this.specularColor&&this.specularColor.isColor&&(n.specularColor=this.specularColor.getHex()),this.shininess!==void 0&&(n.shininess=this.shininess),this.clearcoat!==void 0&&(n.clearcoat=this.clearcoat),this.clearcoatRoughness!==void 0&&(n.clearcoatRoughness=this.clearcoatRoughness),this.diffuseRoughness!==void 0&&(n.diffuseRoughness=this.diffuseRoughness),this.diffuseRoughnessMap&&this.diffuseRoughnessMap.isTexture&&(n.diffuseRoughnessMap=this.diffuseRoughnessMap.toJSON(e).uuid),this.clearcoatMap&&this.clearcoatMap.isTexture&&(n.clearcoatMap=this.clearcoatMap.toJSON(e).uuid),this.clearcoatRoughnessMap&&this.clearcoatRoughnessMap.isTexture&&(n.clearcoatRoughnessMap=this.clearcoatRoughnessMap.toJSON(e).uuid),this.clearcoatNormalMap&&this.clearcoatNormalMap.isTexture&&(n.clearcoatNormalMap=this.clearcoatNormalMap.toJSON(e).uuid,n.clearcoatNormalScale=this.clearcoatNormalScale.toArray()),this.sheenColorMap&&this.sheenColorMap.isTexture&&(n.sheenColorMap=this.sheenColorMap.toJSON(e).uuid),this.sheenRoughnessMap&&this.sheenRoughnessMap.isTexture&&(n.sheenRoughnessMap=this.sheenRoughnessMap.toJSON(e).uuid),this.dispersion!==void 0&&(n.dispersion=this.dispersion),this.retroreflectivity!==void 0&&(n.retroreflectivity=this.retroreflectivity),this.iridescence!==void 0&&(n.iridescence=this.iridescence),this.iridescenceIOR!==void 0&&(n.iridescenceIOR=this.iridescenceIOR),this.iridescenceThicknessMinimum!==void 0&&(n.iridescenceThicknessMinimum=this.iridescenceThicknessMinimum),this.iridescenceThicknessMaximum!==void 0&&(n.iridescenceThicknessMaximum=this.iridescenceThicknessMaximum),this.iridescenceMap&&this.iridescenceMap.isTexture&&(n.iridescenceMap=this.iridescenceMap.toJSON(e).uuid),this.iridescenceThicknessMap&&this.iridescenceThicknessMap.isTexture&&(n.iridescenceThicknessMap=this.iridescenceThicknessMap.toJSON(e).uuid),this.anisotropy!==void 0&&(n.anisotropy=this.anisotropy),this.anisotropyRotation!==void 0&&(n.anisotropyRotation=this.anisotropyRotation),this.anisotropyMap&&this.anisotropyMap.isTexture&&(n.anisotropyMap=this.anisotropyMap.toJSON(e).uuid),this.map&&this.map.isTexture&&(n.map=this.map.toJSON(e).uuid),this.matcap&&this.matcap.isTexture&&(n.matcap=this.matcap.toJSON(e).uuid),this.alphaMap&&this.alphaMap.isTexture&&(n.alphaMap=this.alphaMap.toJSON(e).uuid),this.lightMap&&this.lightMap.isTexture&&(n.lightMap=this.lightMap.toJSON(e).uuid,n.lightMapIntensity=this.lightMapIntensity),this.aoMap&&this.aoMap.isTexture&&(n.aoMap=this.aoMap.toJSON(e).uuid,n.aoMapIntensity=this.aoMapIntensity),this.bumpMap&&this.bumpMap.isTexture&&(n.bumpMap=this.bumpMap.toJSON(e).uuid,n.bumpScale=this.bumpScale),this.normalMap&&this.normalMap.isTexture&&(n.normalMap=this.normalMap.toJSON(e).uuid,n.normalMapType=this.normalMapType,n.normalScale=this.normalScale.toArray()),this.displacementMap&&this.displacementMap.isTexture&&(n.displacementMap=this.displacementMap.toJSON(e).uuid,n.displacementScale=this.displacementScale,n.displacementBias=this.displacementBias),this.roughnessMap&&this.roughnessMap.isTexture&&(n.roughnessMap=this.roughnessMap.toJSON(e).uuid),this.metalnessMap&&this.metalnessMap.isTexture&&(n.metalnessMap=this.metalnessMap.toJSON(e).uuid),this.emissiveMap&&this.emissiveMap.isTexture&&(n.emissiveMap=this.emissiveMap.toJSON(e).uuid),this.specularMap&&this.specularMap.isTexture&&(n.specularMap=this.specularMap.toJSON(e).uuid),this.specularIntensityMap&&this.specularIntensityMap.isTexture&&(n.specularIntensityMap=this.specularIntensityMap.toJSON(e).uuid),this.specularColorMap&&this.specularColorMap.isTexture&&(n.specularColorMap=this.specularColorMap.toJSON(e).uuid),this.envMap&&this.envMap.isTexture&&(n.envMap=this.envMap.toJSON(e).uuid,this.combine!==void 0&&(n.combine=this.combine)),this.envMapRotation!==void 0&&(n.envMapRotation=this.envMapRotation.toArray()),this.envMapIntensity!==void 0&&(n.envMapIntensity=this.envMapIntensity),this.reflectivity!==void 0&&(n.reflectivity=this.reflectivity),this.refractionRatio!==void 0&&(n.refractionRatio=this.refractionRatio),this.gradientMap&&this.gradientMap.isTexture&&(n.gradientMap=this.gradientMap.toJSON(e).uuid),this.transmission!==void 0&&(n.transmission=this.transmission),this.transmissionMap&&this.transmissionMap.isTexture&&(n.transmissionMap=this.transmissionMap.toJSON(e).uuid),this.thickness!==void 0&&(n.thickness=this.thickness),this.thicknessMap&&this.thicknessMap.isTexture&&(n.thicknessMap=this.thicknessMap.toJSON(e).uuid),this.attenuationDistance!==void 0&&(n.attenuationDistance=this.attenuationDistance),this.attenuationColor!==void 0&&(n.attenuationColor=this.attenuationColor.getHex()),this.size!==void 0&&(n.size=this.size),this.sizeAttenuation!==void 0&&(n.sizeAttenuation=this.sizeAttenuation),Array.isArray(this.clippingPlanes)&&this.clippingPlanes.length>0&&(n.clippingPlanes=this.clippingPlanes.map(e=>e.toJSON())),this.rotation!==void 0&&(n.rotation=this.rotation),this.depthPacking!==void 0&&(n.depthPacking=this.depthPacking),this.linewidth!==void 0&&(n.linewidth=this.linewidth),this.linecap!==void 0&&(n.linecap=this.linecap),this.linejoin!==void 0&&(n.linejoin=this.linejoin),this.dashSize!==void 0&&(n.dashSize=this.dashSize),this.gapSize!==void 0&&(n.gapSize=this.gapSize),this.scale!==void 0&&(n.scale=this.scale),this.wireframe!==void 0&&(n.wireframe=this.wireframe),this.wireframeLinewidth!==void 0&&(n.wireframeLinewidth=this.wireframeLinewidth),this.wireframeLinecap!==void 0&&(n.wireframeLinecap=this.wireframeLinecap),this.wireframeLinejoin!==void 0&&(n.wireframeLinejoin=this.wireframeLinejoin),this.flatShading!==void 0&&(n.flatShading=this.flatShading),this.fog!==void 0&&(n.fog=this.fog),Object.keys(this.userData).length>0&&(n.userData=this.userData);function r(e){let t=[];for(let n in e){let r=e[n];delete r.metadata,t.push(r)}return t}if(t){let t=r(e.textures),i=r(e.images);t.length>0&&(n.textures=t),i.length>0&&(n.images=i)}return n}fromJSON(e,t){if(e.uuid!==void 0&&(this.uuid=e.uuid),e.name!==void 0&&(this.name=e.name),e.color!==void 0&&this.color!==void 0&&this.color.setHex(e.color),e.roughness!==void 0&&(this.roughness=e.roughness),e.metalness!==void 0&&(this.metalness=e.metalness),e.sheen!==void 0&&(this.sheen=e.sheen),e.sheenColor!==void 0&&(this.sheenColor=new Y().setHex(e.sheenColor)),e.sheenRoughness!==void 0&&(this.sheenRoughness=e.sheenRoughness),e.emissive!==void 0&&this.emissive!==void 0&&this.emissive.setHex(e.emissive),e.specular!==void 0&&this.specular!==void 0&&this.specular.setHex(e.specular),e.specularIntensity!==void 0&&(this.specularIntensity=e.specularIntensity),e.specularColor!==void 0&&this.specularColor!==void 0&&this.specularColor.setHex(e.specularColor),e.shininess!==void 0&&(this.shininess=e.shininess),e.clearcoat!==void 0&&(this.clearcoat=e.clearcoat),e.clearcoatRoughness!==void 0&&(this.clearcoatRoughness=e.clearcoatRoughness),e.diffuseRoughness!==void 0&&(this.diffuseRoughness=e.diffuseRoughness),e.dispersion!==void 0&&(this.dispersion=e.dispersion),e.retroreflectivity!==void 0&&(this.retroreflectivity=e.retroreflectivity),e.iridescence!==void 0&&(this.iridescence=e.iridescence),e.iridescenceIOR!==void 0&&(this.iridescenceIOR=e.iridescenceIOR),e.iridescenceThicknessMinimum!==void 0&&(this.iridescenceThicknessMinimum=e.iridescenceThicknessMinimum),e.iridescenceThicknessMaximum!==void 0&&(this.iridescenceThicknessMaximum=e.iridescenceThicknessMaximum),e.iridescenceThicknessRange!==void 0&&(this.iridescenceThicknessMinimum=e.iridescenceThicknessRange[0],this.iridescenceThicknessMaximum=e.iridescenceThicknessRange[1]),e.transmission!==void 0&&(this.transmission=e.transmission),e.thickness!==void 0&&(this.thickness=e.thickness),e.attenuationDistance!==void 0&&(this.attenuationDistance=e.attenuationDistance),e.attenuationColor!==void 0&&this.attenuationColor!==void 0&&this.attenuationColor.setHex(e.attenuationColor),e.anisotropy!==void 0&&(this.anisotropy=e.anisotropy),e.anisotropyRotation!==void 0&&(this.anisotropyRotation=e.anisotropyRotation),e.fog!==void 0&&(this.fog=e.fog),e.flatShading!==void 0&&(this.flatShading=e.flatShading),e.blending!==void 0&&(this.blending=e.blending),e.combine!==void 0&&(this.combine=e.combine),e.side!==void 0&&(this.side=e.side),e.shadowSide!==void 0&&(this.shadowSide=e.shadowSide),e.opacity!==void 0&&(this.opacity=e.opacity),e.transparent!==void 0&&(this.transparent=e.transparent),e.alphaTest!==void 0&&(this.alphaTest=e.alphaTest),e.alphaHash!==void 0&&(this.alphaHash=e.alphaHash),e.depthFunc!==void 0&&(this.depthFunc=e.depthFunc),e.depthTest!==void 0&&(this.depthTest=e.depthTest),e.depthWrite!==void 0&&(this.depthWrite=e.depthWrite),e.colorWrite!==void 0&&(this.colorWrite=e.colorWrite),e.clippingPlanes!==void 0&&(this.clippingPlanes=e.clippingPlanes.map(e=>new Sa().fromJSON(e))),e.clipIntersection!==void 0&&(this.clipIntersection=e.clipIntersection),e.clipShadows!==void 0&&(this.clipShadows=e.clipShadows),e.depthPacking!==void 0&&(this.depthPacking=e.depthPacking),e.blendSrc!==void 0&&(this.blendSrc=e.blendSrc),e.blendDst!==void 0&&(this.blendDst=e.blendDst),e.blendEquation!==void 0&&(this.blendEquation=e.blendEquation),e.blendSrcAlpha!==void 0&&(this.blendSrcAlpha=e.blendSrcAlpha),e.blendDstAlpha!==void 0&&(this.blendDstAlpha=e.blendDstAlpha),e.blendEquationAlpha!==void 0&&(this.blendEquationAlpha=e.blendEquationAlpha),e.blendColor!==void 0&&this.blendColor!==void 0&&this.blendColor.setHex(e.blendColor),e.blendAlpha!==void 0&&(this.blendAlpha=e.blendAlpha),e.stencilWriteMask!==void 0&&(this.stencilWriteMask=e.stencilWriteMask),e.stencilFunc!==void 0&&(this.stencilFunc=e.stencilFunc),e.stencilRef!==void 0&&(this.stencilRef=e.stencilRef),e.stencilFuncMask!==void 0&&(this.stencilFuncMask=e.stencilFuncMask),e.stencilFail!==void 0&&(this.stencilFail=e.stencilFail),e.stencilZFail!==void 0&&(this.stencilZFail=e.stencilZFail),e.stencilZPass!==void 0&&(this.stencilZPass=e.stencilZPass),e.stencilWrite!==void 0&&(this.stencilWrite=e.stencilWrite),e.wireframe!==void 0&&(this.wireframe=e.wireframe),e.wireframeLinewidth!==void 0&&(this.wireframeLinewidth=e.wireframeLinewidth),e.wireframeLinecap!==void 0&&(this.wireframeLinecap=e.wireframeLinecap),e.wireframeLinejoin!==void 0&&(this.wireframeLinejoin=e.wireframeLinejoin),e.rotation!==void 0&&(this.rotation=e.rotation),e.linewidth!==void 0&&(this.linewidth=e.linewidth),e.linecap!==void 0&&(this.linecap=e.linecap),e.linejoin!==void 0&&(this.linejoin=e.linejoin),e.dashSize!==void 0&&(this.dashSize=e.dashSize),e.gapSize!==void 0&&(this.gapSize=e.gapSize),e.scale!==void 0&&(this.scale=e.scale),e.polygonOffset!==void 0&&(this.polygonOffset=e.polygonOffset),e.polygonOffsetFactor!==void 0&&(this.polygonOffsetFactor=e.polygonOffsetFactor),e.polygonOffsetUnits!==void 0&&(this.polygonOffsetUnits=e.polygonOffsetUnits),e.dithering!==void 0&&(this.dithering=e.dithering),e.alphaToCoverage!==void 0&&(this.alphaToCoverage=e.alphaToCoverage),e.premultipliedAlpha!==void 0&&(this.premultipliedAlpha=e.premultipliedAlpha),e.forceSinglePass!==void 0&&(this.forceSinglePass=e.forceSinglePass),e.allowOverride!==void 0&&(this.allowOverride=e.allowOverride),e.visible!==void 0&&(this.visible=e.visible),e.toneMapped!==void 0&&(this.toneMapped=e.toneMapped),e.userData!==void 0&&(this.userData=e.userData),e.vertexColors!==void 0&&(this.vertexColors=typeof e.vertexColors==`number`?e.vertexColors>0:e.vertexColors),e.size!==void 0&&(this.size=e.size),e.sizeAttenuation!==void 0&&(this.sizeAttenuation=e.sizeAttenuation),e.map!==void 0&&(this.map=t[e.map]||null),e.matcap!==void 0&&(this.matcap=t[e.matcap]||null),e.alphaMap!==void 0&&(this.alphaMap=t[e.alphaMap]||null),e.bumpMap!==void 0&&(this.bumpMap=t[e.bumpMap]||null),e.bumpScale!==void 0&&(this.bumpScale=e.bumpScale),e.normalMap!==void 0&&(this.normalMap=t[e.normalMap]||null),e.normalMapType!==void 0&&(this.normalMapType=e.normalMapType),e.normalScale!==void 0){let t=e.normalScale;Array.isArray(t)===!1&&(t=[t,t]),this.normalScale=new K().fromArray(t)}return e.displacementMap!==void 0&&(this.displacementMap=t[e.displacementMap]||null),e.displacementScale!==void 0&&(this.displacementScale=e.displacementScale),e.displacementBias!==void 0&&(this.displacementBias=e.displacementBias),e.roughnessMap!==void 0&&(this.roughnessMap=t[e.roughnessMap]||null),e.metalnessMap!==void 0&&(this.metalnessMap=t[e.metalnessMap]||null),e.emissiveMap!==void 0&&(this.emissiveMap=t[e.emissiveMap]||null),e.emissiveIntensity!==void 0&&(this.emissiveIntensity=e.emissiveIntensity),e.specularMap!==void 0&&(this.specularMap=t[e.specularMap]||null),e.specularIntensityMap!==void 0&&(this.specularIntensityMap=t[e.specularIntensityMap]||null),e.specularColorMap!==void 0&&(this.specularColorMap=t[e.specularColorMap]||null),e.envMap!==void 0&&(this.envMap=t[e.envMap]||null),e.envMapRotation!==void 0&&this.envMapRotation.fromArray(e.envMapRotation),e.envMapIntensity!==void 0&&(this.envMapIntensity=e.envMapIntensity),e.reflectivity!==void 0&&(this.reflectivity=e.reflectivity),e.refractionRatio!==void 0&&(this.refractionRatio=e.refractionRatio),e.lightMap!==void 0&&(this.lightMap=t[e.lightMap]||null),e.lightMapIntensity!==void 0&&(this.lightMapIntensity=e.lightMapIntensity),e.aoMap!==void 0&&(this.aoMap=t[e.aoMap]||null),e.aoMapIntensity!==void 0&&(this.aoMapIntensity=e.aoMapIntensity),e.gradientMap!==void 0&&(this.gradientMap=t[e.gradientMap]||null),e.clearcoatMap!==void 0&&(this.clearcoatMap=t[e.clearcoatMap]||null),e.clearcoatRoughnessMap!==void 0&&(this.clearcoatRoughnessMap=t[e.clearcoatRoughnessMap]||null),e.clearcoatNormalMap!==void 0&&(this.clearcoatNormalMap=t[e.clearcoatNormalMap]||null),e.clearcoatNormalScale!==void 0&&(this.clearcoatNormalScale=new K().fromArray(e.clearcoatNormalScale)),e.diffuseRoughnessMap!==void 0&&(this.diffuseRoughnessMap=t[e.diffuseRoughnessMap]||null),e.iridescenceMap!==void 0&&(this.iridescenceMap=t[e.iridescenceMap]||null),e.iridescenceThicknessMap!==void 0&&(this.iridescenceThicknessMap=t[e.iridescenceThicknessMap]||null),e.transmissionMap!==void 0&&(this.transmissionMap=t[e.transmissionMap]||null),e.thicknessMap!==void 0&&(this.thicknessMap=t[e.thicknessMap]||null),e.anisotropyMap!==void 0&&(this.anisotropyMap=t[e.anisotropyMap]||null),e.sheenColorMap!==void 0&&(this.sheenColorMap=t[e.sheenColorMap]||null),e.sheenRoughnessMap!==void 0&&(this.sheenRoughnessMap=t[e.sheenRoughnessMap]||null),this}clone(){return new this.constructor().copy(this)}copy(e){this.name=e.name,this.blending=e.blending,this.side=e.side,this.vertexColors=e.vertexColors,this.opacity=e.opacity,this.transparent=e.transparent,this.blendSrc=e.blendSrc,this.blendDst=e.blendDst,this.blendEquation=e.blendEquation,this.blendSrcAlpha=e.blendSrcAlpha,this.blendDstAlpha=e.blendDstAlpha,this.blendEquationAlpha=e.blendEquationAlpha,this.blendColor.copy(e.blendColor),this.blendAlpha=e.blendAlpha,this.depthFunc=e.depthFunc,this.depthTest=e.depthTest,this.depthWrite=e.depthWrite,this.stencilWriteMask=e.stencilWriteMask,this.stencilFunc=e.stencilFunc,this.stencilRef=e.stencilRef,this.stencilFuncMask=e.stencilFuncMask,this.stencilFail=e.stencilFail,this.stencilZFail=e.stencilZFail,this.stencilZPass=e.stencilZPass,this.stencilWrite=e.stencilWrite;let t=e.clippingPlanes,n=null;if(t!==null){let e=t.length;n=Array(e);for(let r=0;r!==e;++r)n[r]=t[r].clone()}return this.clippingPlanes=n,this.clipIntersection=e.clipIntersection,this.clipShadows=e.clipShadows,this.shadowSide=e.shadowSide,this.colorWrite=e.colorWrite,this.precision=e.precision,this.polygonOffset=e.polygonOffset,this.polygonOffsetFactor=e.polygonOffsetFactor,this.polygonOffsetUnits=e.polygonOffsetUnits,this.dithering=e.dithering,this.alphaTest=e.alphaTest,this.alphaHash=e.alphaHash,this.alphaToCoverage=e.alphaToCoverage,this.premultipliedAlpha=e.premultipliedAlpha,this.forceSinglePass=e.forceSinglePass,this.allowOverride=e.allowOverride,this.visible=e.visible,this.toneMapped=e.toneMapped,this.userData=JSON.parse(JSON.stringify(e.userData)),this}dispose(){this.dispatchEvent({type:`dispose`})}set needsUpdate(e){e===!0&&this.version++}},Ta=new q,Ea=new q,Da=new q,Oa=new q,ka=class{constructor(e=new q,t=new q(0,0,-1)){this.origin=e,this.direction=t}set(e,t){return this.origin.copy(e),this.direction.copy(t),this}copy(e){return this.origin.copy(e.origin),this.direction.copy(e.direction),this}at(e,t){return t.copy(this.origin).addScaledVector(this.direction,e)}lookAt(e){return this.direction.copy(e).sub(this.origin).normalize(),this}recast(e){return this.origin.copy(this.at(e,Ta)),this}closestPointToPoint(e,t){t.subVectors(e,this.origin);let n=t.dot(this.direction);return n<0?t.copy(this.origin):t.copy(this.origin).addScaledVector(this.direction,n)}distanceToPoint(e){return Math.sqrt(this.distanceSqToPoint(e))}distanceSqToPoint(e){let t=Ta.subVectors(e,this.origin).dot(this.direction);return t<0?this.origin.distanceToSquared(e):(Ta.copy(this.origin).addScaledVector(this.direction,t),Ta.distanceToSquared(e))}distanceSqToSegment(e,t,n,r){Ea.copy(e).add(t).multiplyScalar(.5),Da.copy(t).sub(e).normalize(),Oa.copy(this.origin).sub(Ea);let i=e.distanceTo(t)*.5,a=-this.direction.dot(Da),o=Oa.dot(this.direction),s=-Oa.dot(Da),c=Oa.lengthSq(),l=Math.abs(1-a*a),u,d,f,p;if(l>0){if(u=a*s-o,d=a*o-s,p=i*l,u>=0){if(d>=-p){if(d<=p){let e=1/l;u*=e,d*=e,f=u*(u+a*d+2*o)+d*(a*u+d+2*s)+c}else d=i,u=Math.max(0,-(a*d+o)),f=-u*u+d*(d+2*s)+c}else d=-i,u=Math.max(0,-(a*d+o)),f=-u*u+d*(d+2*s)+c}else d<=-p?(u=Math.max(0,-(-a*i+o)),d=u>0?-i:Math.min(Math.max(-i,-s),i),f=-u*u+d*(d+2*s)+c):d<=p?(u=0,d=Math.min(Math.max(-i,-s),i),f=d*(d+2*s)+c):(u=Math.max(0,-(a*i+o)),d=u>0?i:Math.min(Math.max(-i,-s),i),f=-u*u+d*(d+2*s)+c)}else d=a>0?-i:i,u=Math.max(0,-(a*d+o)),f=-u*u+d*(d+2*s)+c;return n&&n.copy(this.origin).addScaledVector(this.direction,u),r&&r.copy(Ea).addScaledVector(Da,d),f}intersectSphere(e,t){if(e.radius<0)return null;Ta.subVectors(e.center,this.origin);let n=Ta.dot(this.direction),r=Ta.dot(Ta)-n*n,i=e.radius*e.radius;if(r>i)return null;let a=Math.sqrt(i-r),o=n-a,s=n+a;return s<0?null:o<0?this.at(s,t):this.at(o,t)}intersectsSphere(e){return e.radius<0?!1:this.distanceSqToPoint(e.center)<=e.radius*e.radius}distanceToPlane(e){let t=e.normal.dot(this.direction);if(t===0)return e.distanceToPoint(this.origin)===0?0:null;let n=-(this.origin.dot(e.normal)+e.constant)/t;return n>=0?n:null}intersectPlane(e,t){let n=this.distanceToPlane(e);return n===null?null:this.at(n,t)}intersectsPlane(e){let t=e.distanceToPoint(this.origin);return t===0||e.normal.dot(this.direction)*t<0}intersectBox(e,t){let n,r,i,a,o,s,c=1/this.direction.x,l=1/this.direction.y,u=1/this.direction.z,d=this.origin;return c>=0?(n=(e.min.x-d.x)*c,r=(e.max.x-d.x)*c):(n=(e.max.x-d.x)*c,r=(e.min.x-d.x)*c),l>=0?(i=(e.min.y-d.y)*l,a=(e.max.y-d.y)*l):(i=(e.max.y-d.y)*l,a=(e.min.y-d.y)*l),n>a||i>r||((i>n||isNaN(n))&&(n=i),(a<r||isNaN(r))&&(r=a),u>=0?(o=(e.min.z-d.z)*u,s=(e.max.z-d.z)*u):(o=(e.max.z-d.z)*u,s=(e.min.z-d.z)*u),n>s||o>r)||((o>n||n!==n)&&(n=o),(s<r||r!==r)&&(r=s),r<0)?null:this.at(n>=0?n:r,t)}intersectsBox(e){return this.intersectBox(e,Ta)!==null}intersectTriangle(e,t,n,r,i){let a=this.origin,o=this.direction,s=o.x,c=o.y,l=o.z,u=e.x-a.x,d=e.y-a.y,f=e.z-a.z,p=t.x-a.x,m=t.y-a.y,h=t.z-a.z,g=n.x-a.x,_=n.y-a.y,v=n.z-a.z,y=Math.abs(s),b=Math.abs(c),x=Math.abs(l),S,C,w,T,E,D,O,k,A,j,M,N;if(y>=b&&y>=x?(w=s,D=u,A=p,N=g,s>=0?(S=c,C=l,T=d,E=f,O=m,k=h,j=_,M=v):(S=l,C=c,T=f,E=d,O=h,k=m,j=v,M=_)):b>=x?(w=c,D=d,A=m,N=_,c>=0?(S=l,C=s,T=f,E=u,O=h,k=p,j=v,M=g):(S=s,C=l,T=u,E=f,O=p,k=h,j=g,M=v)):(w=l,D=f,A=h,N=v,l>=0?(S=s,C=c,T=u,E=d,O=p,k=m,j=g,M=_):(S=c,C=s,T=d,E=u,O=m,k=p,j=_,M=g)),w===0)return null;let P=S/w,ee=C/w,F=1/w,te=T-P*D,ne=E-ee*D,re=O-P*A,ie=k-ee*A,I=j-P*N,ae=M-ee*N,oe=I*ie-ae*re,L=te*ae-ne*I,R=re*ne-ie*te;if(r){if(oe<0||L<0||R<0)return null}else if((oe<0||L<0||R<0)&&(oe>0||L>0||R>0))return null;let se=oe+L+R;if(se===0)return null;let ce=F*(oe*D+L*A+R*N);return(se>0?ce<0:ce>0)?null:this.at(ce/se,i)}applyMatrix4(e){return this.origin.applyMatrix4(e),this.direction.transformDirection(e),this}equals(e){return e.origin.equals(this.origin)&&e.direction.equals(this.direction)}clone(){return new this.constructor().copy(this)}},Aa=class extends wa{constructor(e){super(),this.isMeshBasicMaterial=!0,this.type=`MeshBasicMaterial`,this.color=new Y(16777215),this.map=null,this.lightMap=null,this.lightMapIntensity=1,this.aoMap=null,this.aoMapIntensity=1,this.specularMap=null,this.alphaMap=null,this.envMap=null,this.envMapRotation=new Jr,this.combine=0,this.reflectivity=1,this.refractionRatio=.98,this.wireframe=!1,this.wireframeLinewidth=1,this.wireframeLinecap=`round`,this.wireframeLinejoin=`round`,this.fog=!0,this.setValues(e)}copy(e){return super.copy(e),this.color.copy(e.color),this.map=e.map,this.lightMap=e.lightMap,this.lightMapIntensity=e.lightMapIntensity,this.aoMap=e.aoMap,this.aoMapIntensity=e.aoMapIntensity,this.specularMap=e.specularMap,this.alphaMap=e.alphaMap,this.envMap=e.envMap,this.envMapRotation.copy(e.envMapRotation),this.combine=e.combine,this.reflectivity=e.reflectivity,this.refractionRatio=e.refractionRatio,this.wireframe=e.wireframe,this.wireframeLinewidth=e.wireframeLinewidth,this.wireframeLinecap=e.wireframeLinecap,this.wireframeLinejoin=e.wireframeLinejoin,this.fog=e.fog,this}},ja=new Rr,Ma=new ka,Na=new oa,Pa=new q,Fa=new q,Ia=new q,La=new q,Ra=new q,za=new q,Ba=new q,Va=new q,Ha=class extends di{constructor(e=new ma,t=new Aa){super(),this.isMesh=!0,this.type=`Mesh`,this.geometry=e,this.material=t,this.morphTargetDictionary=void 0,this.morphTargetInfluences=void 0,this.count=1,this.updateMorphTargets()}copy(e,t){return super.copy(e,t),this.morphTargetInfluences=e.morphTargetInfluences===void 0?void 0:e.morphTargetInfluences.slice(),this.morphTargetDictionary=e.morphTargetDictionary===void 0?void 0:Object.assign({},e.morphTargetDictionary),this.material=Array.isArray(e.material)?e.material.slice():e.material,this.geometry=e.geometry,this}updateMorphTargets(){let e=this.geometry.morphAttributes,t=Object.keys(e);if(t.length>0){let n=e[t[0]];if(n!==void 0){this.morphTargetInfluences=[],this.morphTargetDictionary={};for(let e=0,t=n.length;e<t;e++){let t=n[e].name||String(e);this.morphTargetInfluences.push(0),this.morphTargetDictionary[t]=e}}}}getVertexPosition(e,t){let n=this.geometry,r=n.attributes.position,i=n.morphAttributes.position,a=n.morphTargetsRelative;t.fromBufferAttribute(r,e);let o=this.morphTargetInfluences;if(i&&o){za.set(0,0,0);for(let n=0,r=i.length;n<r;n++){let r=o[n],s=i[n];r!==0&&(Ra.fromBufferAttribute(s,e),a?za.addScaledVector(Ra,r):za.addScaledVector(Ra.sub(t),r))}t.add(za)}return t}intersectsFrustum(e){return e.intersectsObject(this)}raycast(e,t){let n=this.geometry,r=this.material,i=this.matrixWorld;r!==void 0&&(n.boundingSphere===null&&n.computeBoundingSphere(),Na.copy(n.boundingSphere),Na.applyMatrix4(i),Ma.copy(e.ray).recast(e.near),Na.containsPoint(Ma.origin)===!1&&(Ma.intersectSphere(Na,Pa)===null||Ma.origin.distanceToSquared(Pa)>(e.far-e.near)**2)||(ja.copy(i).invert(),Ma.copy(e.ray).applyMatrix4(ja),(n.boundingBox===null||Ma.intersectsBox(n.boundingBox)!==!1)&&this._computeIntersections(e,t,Ma)))}_computeIntersections(e,t,n){let r,i=this.geometry,a=this.material,o=i.index,s=i.attributes.position,c=i.attributes.uv,l=i.attributes.uv1,u=i.attributes.normal,d=i.groups,f=i.drawRange;if(o!==null){if(Array.isArray(a))for(let i=0,s=d.length;i<s;i++){let s=d[i],p=a[s.materialIndex],m=Math.max(s.start,f.start),h=Math.min(o.count,Math.min(s.start+s.count,f.start+f.count));for(let i=m,a=h;i<a;i+=3){let a=o.getX(i),d=o.getX(i+1),f=o.getX(i+2);r=Wa(this,p,e,n,c,l,u,a,d,f),r&&(r.faceIndex=Math.floor(i/3),r.face.materialIndex=s.materialIndex,t.push(r))}}else{let i=Math.max(0,f.start),s=Math.min(o.count,f.start+f.count);for(let d=i,f=s;d<f;d+=3){let i=o.getX(d),s=o.getX(d+1),f=o.getX(d+2);r=Wa(this,a,e,n,c,l,u,i,s,f),r&&(r.faceIndex=Math.floor(d/3),t.push(r))}}}else if(s!==void 0){if(Array.isArray(a))for(let i=0,o=d.length;i<o;i++){let o=d[i],p=a[o.materialIndex],m=Math.max(o.start,f.start),h=Math.min(s.count,Math.min(o.start+o.count,f.start+f.count));for(let i=m,a=h;i<a;i+=3){let a=i,s=i+1,d=i+2;r=Wa(this,p,e,n,c,l,u,a,s,d),r&&(r.faceIndex=Math.floor(i/3),r.face.materialIndex=o.materialIndex,t.push(r))}}else{let i=Math.max(0,f.start),o=Math.min(s.count,f.start+f.count);for(let s=i,d=o;s<d;s+=3){let i=s,o=s+1,d=s+2;r=Wa(this,a,e,n,c,l,u,i,o,d),r&&(r.faceIndex=Math.floor(s/3),t.push(r))}}}}};function Ua(e,t,n,r,i,a,o,s){let c;if(c=t.side===1?r.intersectTriangle(o,a,i,!0,s):r.intersectTriangle(i,a,o,t.side===0,s),c===null)return null;Va.copy(s),Va.applyMatrix4(e.matrixWorld);let l=n.ray.origin.distanceTo(Va);return l<n.near||l>n.far?null:{distance:l,point:Va.clone(),object:e}}function Wa(e,t,n,r,i,a,o,s,c,l){e.getVertexPosition(s,Fa),e.getVertexPosition(c,Ia),e.getVertexPosition(l,La);let u=Ua(e,t,n,r,Fa,Ia,La,Ba);if(u){let e=new q;Pi.getBarycoord(Ba,Fa,Ia,La,e),i&&(u.uv=Pi.getInterpolatedAttribute(i,s,c,l,e,new K)),a&&(u.uv1=Pi.getInterpolatedAttribute(a,s,c,l,e,new K)),o&&(u.normal=Pi.getInterpolatedAttribute(o,s,c,l,e,new q),u.normal.dot(r.direction)>0&&u.normal.multiplyScalar(-1));let t={a:s,b:c,c:l,normal:new q,materialIndex:0};Pi.getNormal(Fa,Ia,La,t.normal),u.face=t,u.barycoord=e}return u}var Ga=class extends Mr{constructor(e=null,t=1,n=1,r,i,a,o,s,c=rt,l=rt,u,d){super(null,a,o,s,c,l,r,i,u,d),this.isDataTexture=!0,this.image={data:e,width:t,height:n},this.generateMipmaps=!1,this.flipY=!1,this.unpackAlignment=1}},Ka=class extends $i{constructor(e,t,n,r=1){super(e,t,n),this.isInstancedBufferAttribute=!0,this.meshPerAttribute=r}copy(e){return super.copy(e),this.meshPerAttribute=e.meshPerAttribute,this}toJSON(){let e=super.toJSON();return e.meshPerAttribute=this.meshPerAttribute,e.isInstancedBufferAttribute=!0,e}},qa=new Rr,Ja=new Rr,Ya=[],Xa=new Fi,Za=new Rr,Qa=new Ha,$a=new oa,eo=class extends Ha{constructor(e,t,n){super(e,t),this.isInstancedMesh=!0,this.instanceMatrix=new Ka(new Float32Array(n*16),16),this.instanceColor=null,this.morphTexture=null,this.count=n,this.boundingBox=null,this.boundingSphere=null;for(let e=0;e<n;e++)this.setMatrixAt(e,Za)}computeBoundingBox(){let e=this.geometry,t=this.count;this.boundingBox===null&&(this.boundingBox=new Fi),e.boundingBox===null&&e.computeBoundingBox(),this.boundingBox.makeEmpty();for(let n=0;n<t;n++)this.getMatrixAt(n,qa),Xa.copy(e.boundingBox).applyMatrix4(qa),this.boundingBox.union(Xa)}computeBoundingSphere(){let e=this.geometry,t=this.count;this.boundingSphere===null&&(this.boundingSphere=new oa),e.boundingSphere===null&&e.computeBoundingSphere(),this.boundingSphere.makeEmpty();for(let n=0;n<t;n++)this.getMatrixAt(n,qa),$a.copy(e.boundingSphere).applyMatrix4(qa),this.boundingSphere.union($a)}copy(e,t){return super.copy(e,t),this.instanceMatrix.copy(e.instanceMatrix),this.morphTexture=e.morphTexture===null?null:e.morphTexture.clone(),this.instanceColor=e.instanceColor===null?null:e.instanceColor.clone(),this.count=e.count,this.boundingBox=e.boundingBox===null?null:e.boundingBox.clone(),this.boundingSphere=e.boundingSphere===null?null:e.boundingSphere.clone(),this}getColorAt(e,t){return this.instanceColor===null?t.setRGB(1,1,1):t.fromArray(this.instanceColor.array,e*3)}getMatrixAt(e,t){return t.fromArray(this.instanceMatrix.array,e*16)}getMorphAt(e,t){let n=t.morphTargetInfluences,r=this.morphTexture.source.data.data,i=e*(n.length+1)+1;for(let e=0;e<n.length;e++)n[e]=r[i+e]}raycast(e,t){let n=this.matrixWorld,r=this.count;if(Qa.geometry=this.geometry,Qa.material=this.material,Qa.material!==void 0&&(this.boundingSphere===null&&this.computeBoundingSphere(),$a.copy(this.boundingSphere),$a.applyMatrix4(n),e.ray.intersectsSphere($a)!==!1))for(let i=0;i<r;i++){this.getMatrixAt(i,qa),Ja.multiplyMatrices(n,qa),Qa.matrixWorld=Ja,Qa.raycast(e,Ya);for(let e=0,n=Ya.length;e<n;e++){let n=Ya[e];n.instanceId=i,n.object=this,t.push(n)}Ya.length=0}}setColorAt(e,t){return this.instanceColor===null&&(this.instanceColor=new Ka(new Float32Array(this.instanceMatrix.count*3).fill(1),3)),t.toArray(this.instanceColor.array,e*3),this}setMatrixAt(e,t){return t.toArray(this.instanceMatrix.array,e*16),this}setMorphAt(e,t){let n=t.morphTargetInfluences,r=n.length+1;this.morphTexture===null&&(this.morphTexture=new Ga(new Float32Array(r*this.count),r,this.count,Dt,ht));let i=this.morphTexture.source.data.data,a=0;for(let e=0;e<n.length;e++)a+=n[e];let o=this.geometry.morphTargetsRelative?1:1-a,s=r*e;return i[s]=o,i.set(n,s+1),this}updateMorphTargets(){}dispose(){super.dispose(),this.instanceMatrix.dispose(),this.instanceColor!==null&&this.instanceColor.dispose(),this.morphTexture!==null&&(this.morphTexture.dispose(),this.morphTexture=null)}},to=new oa,no=new K(.5,.5),ro=new q,io=class{constructor(e=new Sa,t=new Sa,n=new Sa,r=new Sa,i=new Sa,a=new Sa){this.planes=[e,t,n,r,i,a]}set(e,t,n,r,i,a){let o=this.planes;return o[0].copy(e),o[1].copy(t),o[2].copy(n),o[3].copy(r),o[4].copy(i),o[5].copy(a),this}copy(e){let t=this.planes;for(let n=0;n<6;n++)t[n].copy(e.planes[n]);return this}setFromProjectionMatrix(e,t=An,n=!1){let r=this.planes,i=e.elements,a=i[0],o=i[1],s=i[2],c=i[3],l=i[4],u=i[5],d=i[6],f=i[7],p=i[8],m=i[9],h=i[10],g=i[11],_=i[12],v=i[13],y=i[14],b=i[15];if(r[0].setComponents(c-a,f-l,g-p,b-_).normalize(),r[1].setComponents(c+a,f+l,g+p,b+_).normalize(),r[2].setComponents(c+o,f+u,g+m,b+v).normalize(),r[3].setComponents(c-o,f-u,g-m,b-v).normalize(),n)r[4].setComponents(s,d,h,y).normalize(),r[5].setComponents(c-s,f-d,g-h,b-y).normalize();else if(r[4].setComponents(c-s,f-d,g-h,b-y).normalize(),t===2e3)r[5].setComponents(c+s,f+d,g+h,b+y).normalize();else if(t===2001)r[5].setComponents(s,d,h,y).normalize();else throw Error(`THREE.Frustum.setFromProjectionMatrix(): Invalid coordinate system: `+t);return this}intersectsObject(e){if(e.boundingSphere!==void 0)e.boundingSphere===null&&e.computeBoundingSphere(),to.copy(e.boundingSphere).applyMatrix4(e.matrixWorld);else{let t=e.geometry;t.boundingSphere===null&&t.computeBoundingSphere(),to.copy(t.boundingSphere).applyMatrix4(e.matrixWorld)}return this.intersectsSphere(to)}intersectsSprite(e){return to.center.set(0,0,0),to.radius=.7071067811865476+no.distanceTo(e.center),to.applyMatrix4(e.matrixWorld),this.intersectsSphere(to)}intersectsSphere(e){let t=this.planes,n=e.center,r=-e.radius;for(let e=0;e<6;e++)if(t[e].distanceToPoint(n)<r)return!1;return!0}intersectsBox(e){let t=this.planes;for(let n=0;n<6;n++){let r=t[n];if(ro.x=r.normal.x>0?e.max.x:e.min.x,ro.y=r.normal.y>0?e.max.y:e.min.y,ro.z=r.normal.z>0?e.max.z:e.min.z,r.distanceToPoint(ro)<0)return!1}return!0}containsPoint(e){let t=this.planes;for(let n=0;n<6;n++)if(t[n].distanceToPoint(e)<0)return!1;return!0}clone(){return new this.constructor().copy(this)}},ao=new Rr,oo=class e{constructor(){this.coordinateSystem=An,this._frustums=[],this._count=0}setFromArrayCamera(e){let t=e.cameras,n=this._frustums;for(let e=0;e<t.length;e++){let r=t[e];ao.multiplyMatrices(r.projectionMatrix,r.matrixWorldInverse),n[e]===void 0&&(n[e]=new io),n[e].setFromProjectionMatrix(ao,r.coordinateSystem,r.reversedDepth)}return this._count=t.length,this}getFrustum(e){return this._frustums[e]}intersectsObject(e){let t=this._frustums;for(let n=0;n<this._count;n++)if(t[n].intersectsObject(e))return!0;return!1}intersectsSprite(e){let t=this._frustums;for(let n=0;n<this._count;n++)if(t[n].intersectsSprite(e))return!0;return!1}intersectsSphere(e){let t=this._frustums;for(let n=0;n<this._count;n++)if(t[n].intersectsSphere(e))return!0;return!1}intersectsBox(e){let t=this._frustums;for(let n=0;n<this._count;n++)if(t[n].intersectsBox(e))return!0;return!1}containsPoint(e){let t=this._frustums;for(let n=0;n<this._count;n++)if(t[n].containsPoint(e))return!0;return!1}copy(e){this.coordinateSystem=e.coordinateSystem;let t=this._frustums,n=e._frustums;for(let r=0;r<e._count;r++)t[r]===void 0&&(t[r]=new io),t[r].copy(n[r]);return this._count=e._count,this}clone(){return new e().copy(this)}},so=class extends wa{constructor(e){super(),this.isLineBasicMaterial=!0,this.type=`LineBasicMaterial`,this.color=new Y(16777215),this.map=null,this.linewidth=1,this.linecap=`round`,this.linejoin=`round`,this.fog=!0,this.setValues(e)}copy(e){return super.copy(e),this.color.copy(e.color),this.map=e.map,this.linewidth=e.linewidth,this.linecap=e.linecap,this.linejoin=e.linejoin,this.fog=e.fog,this}},co=new q,lo=new q,uo=new Rr,fo=new ka,po=new oa,mo=new q,ho=new q,go=class extends di{constructor(e=new ma,t=new so){super(),this.isLine=!0,this.type=`Line`,this.geometry=e,this.material=t,this.morphTargetDictionary=void 0,this.morphTargetInfluences=void 0,this.updateMorphTargets()}copy(e,t){return super.copy(e,t),this.morphTargetInfluences=e.morphTargetInfluences===void 0?void 0:e.morphTargetInfluences.slice(),this.morphTargetDictionary=e.morphTargetDictionary===void 0?void 0:Object.assign({},e.morphTargetDictionary),this.material=Array.isArray(e.material)?e.material.slice():e.material,this.geometry=e.geometry,this}computeLineDistances(){let e=this.geometry;if(e.index===null){let t=e.attributes.position,n=[0];for(let e=1,r=t.count;e<r;e++)co.fromBufferAttribute(t,e-1),lo.fromBufferAttribute(t,e),n[e]=n[e-1],n[e]+=co.distanceTo(lo);e.setAttribute(`lineDistance`,new na(n,1))}else U(`Line.computeLineDistances(): Computation only possible with non-indexed BufferGeometry.`);return this}intersectsFrustum(e){return e.intersectsObject(this)}raycast(e,t){let n=this.geometry,r=this.matrixWorld,i=e.params.Line.threshold,a=n.drawRange;if(n.boundingSphere===null&&n.computeBoundingSphere(),po.copy(n.boundingSphere),po.applyMatrix4(r),po.radius+=i,e.ray.intersectsSphere(po)===!1)return;uo.copy(r).invert(),fo.copy(e.ray).applyMatrix4(uo);let o=i/((this.scale.x+this.scale.y+this.scale.z)/3),s=o*o,c=this.isLineSegments?2:1,l=n.index,u=n.attributes.position;if(l!==null){let n=Math.max(0,a.start),r=Math.min(l.count,a.start+a.count);for(let i=n,a=r-1;i<a;i+=c){let n=l.getX(i),r=l.getX(i+1),a=_o(this,e,fo,s,n,r,i);a&&t.push(a)}if(this.isLineLoop){let i=l.getX(r-1),a=l.getX(n),o=_o(this,e,fo,s,i,a,r-1);o&&t.push(o)}}else{let n=Math.max(0,a.start),r=Math.min(u.count,a.start+a.count);for(let i=n,a=r-1;i<a;i+=c){let n=_o(this,e,fo,s,i,i+1,i);n&&t.push(n)}if(this.isLineLoop){let i=_o(this,e,fo,s,r-1,n,r-1);i&&t.push(i)}}}updateMorphTargets(){let e=this.geometry.morphAttributes,t=Object.keys(e);if(t.length>0){let n=e[t[0]];if(n!==void 0){this.morphTargetInfluences=[],this.morphTargetDictionary={};for(let e=0,t=n.length;e<t;e++){let t=n[e].name||String(e);this.morphTargetInfluences.push(0),this.morphTargetDictionary[t]=e}}}}};function _o(e,t,n,r,i,a,o){let s=e.geometry.attributes.position;if(co.fromBufferAttribute(s,i),lo.fromBufferAttribute(s,a),n.distanceSqToSegment(co,lo,mo,ho)>r)return;mo.applyMatrix4(e.matrixWorld);let c=t.ray.origin.distanceTo(mo);if(!(c<t.near||c>t.far))return{distance:c,point:ho.clone().applyMatrix4(e.matrixWorld),index:o,face:null,faceIndex:null,barycoord:null,object:e}}var vo=new q,yo=new q,bo=class extends go{constructor(e,t){super(e,t),this.isLineSegments=!0,this.type=`LineSegments`}computeLineDistances(){let e=this.geometry;if(e.index===null){let t=e.attributes.position,n=[];for(let e=0,r=t.count;e<r;e+=2)vo.fromBufferAttribute(t,e),yo.fromBufferAttribute(t,e+1),n[e]=e===0?0:n[e-1],n[e+1]=n[e]+vo.distanceTo(yo);e.setAttribute(`lineDistance`,new na(n,1))}else U(`LineSegments.computeLineDistances(): Computation only possible with non-indexed BufferGeometry.`);return this}},xo=class extends go{constructor(e,t){super(e,t),this.isLineLoop=!0,this.type=`LineLoop`}},So=class extends wa{constructor(e){super(),this.isPointsMaterial=!0,this.type=`PointsMaterial`,this.color=new Y(16777215),this.map=null,this.alphaMap=null,this.size=1,this.sizeAttenuation=!0,this.fog=!0,this.setValues(e)}copy(e){return super.copy(e),this.color.copy(e.color),this.map=e.map,this.alphaMap=e.alphaMap,this.size=e.size,this.sizeAttenuation=e.sizeAttenuation,this.fog=e.fog,this}},Co=new Rr,wo=new ka,To=new oa,Eo=new q,Do=class extends di{constructor(e=new ma,t=new So){super(),this.isPoints=!0,this.type=`Points`,this.geometry=e,this.material=t,this.morphTargetDictionary=void 0,this.morphTargetInfluences=void 0,this.updateMorphTargets()}copy(e,t){return super.copy(e,t),this.morphTargetInfluences=e.morphTargetInfluences===void 0?void 0:e.morphTargetInfluences.slice(),this.morphTargetDictionary=e.morphTargetDictionary===void 0?void 0:Object.assign({},e.morphTargetDictionary),this.material=Array.isArray(e.material)?e.material.slice():e.material,this.geometry=e.geometry,this}intersectsFrustum(e){return e.intersectsObject(this)}raycast(e,t){let n=this.geometry,r=this.matrixWorld,i=e.params.Points.threshold,a=n.drawRange;if(n.boundingSphere===null&&n.computeBoundingSphere(),To.copy(n.boundingSphere),To.applyMatrix4(r),To.radius+=i,e.ray.intersectsSphere(To)===!1)return;Co.copy(r).invert(),wo.copy(e.ray).applyMatrix4(Co);let o=i/((this.scale.x+this.scale.y+this.scale.z)/3),s=o*o,c=n.index,l=n.attributes.position;if(c!==null){let n=Math.max(0,a.start),i=Math.min(c.count,a.start+a.count);for(let a=n,o=i;a<o;a++){let n=c.getX(a);Eo.fromBufferAttribute(l,n),Oo(Eo,n,s,r,e,t,this)}}else{let n=Math.max(0,a.start),i=Math.min(l.count,a.start+a.count);for(let a=n,o=i;a<o;a++)Eo.fromBufferAttribute(l,a),Oo(Eo,a,s,r,e,t,this)}}updateMorphTargets(){let e=this.geometry.morphAttributes,t=Object.keys(e);if(t.length>0){let n=e[t[0]];if(n!==void 0){this.morphTargetInfluences=[],this.morphTargetDictionary={};for(let e=0,t=n.length;e<t;e++){let t=n[e].name||String(e);this.morphTargetInfluences.push(0),this.morphTargetDictionary[t]=e}}}}};function Oo(e,t,n,r,i,a,o){let s=wo.distanceSqToPoint(e);if(s<n){let n=new q;wo.closestPointToPoint(e,n),n.applyMatrix4(r);let c=i.ray.origin.distanceTo(n);if(c<i.near||c>i.far)return;a.push({distance:c,distanceToRay:Math.sqrt(s),point:n,index:t,face:null,faceIndex:null,barycoord:null,object:o})}}var ko=class extends Mr{constructor(e=[],t=301,n,r,i,a,o,s,c,l){super(e,t,n,r,i,a,o,s,c,l),this.isCubeTexture=!0,this.flipY=!1}get images(){return this.image}set images(e){this.image=e}},Ao=class extends Mr{constructor(e,t,n,r,i,a,o,s,c){super(e,t,n,r,i,a,o,s,c),this.isCanvasTexture=!0,this.needsUpdate=!0}},jo=class extends Mr{constructor(e,t,n=mt,r,i,a,o=rt,s=rt,c,l=Tt,u=1){if(l!==1026&&l!==1027)throw Error(`THREE.DepthTexture: format must be either THREE.DepthFormat or THREE.DepthStencilFormat`);super({width:e,height:t,depth:u},r,i,a,o,s,l,n,c),this.isDepthTexture=!0,this.flipY=!1,this.generateMipmaps=!1,this.compareFunction=null}copy(e){return super.copy(e),this.source=new Or(Object.assign({},e.image)),this.compareFunction=e.compareFunction,this}toJSON(e){let t=super.toJSON(e);return t.compareFunction=this.compareFunction,t}},Mo=class extends jo{constructor(e,t=mt,n=301,r,i,a=rt,o=rt,s,c=Tt){let l={width:e,height:e,depth:1},u=[l,l,l,l,l,l];super(e,e,t,n,r,i,a,o,s,c),this.image=u,this.isCubeDepthTexture=!0,this.isCubeTexture=!0}get images(){return this.image}set images(e){this.image=e}},No=class extends Mr{constructor(e=null){super(),this.sourceTexture=e,this.isExternalTexture=!0}copy(e){return super.copy(e),this.sourceTexture=e.sourceTexture,this}},Po=class e extends ma{constructor(e=1,t=1,n=1,r=1,i=1,a=1){super(),this.type=`BoxGeometry`,this.parameters={width:e,height:t,depth:n,widthSegments:r,heightSegments:i,depthSegments:a};let o=this;r=Math.floor(r),i=Math.floor(i),a=Math.floor(a);let s=[],c=[],l=[],u=[],d=0,f=0;p(`z`,`y`,`x`,-1,-1,n,t,e,a,i,0),p(`z`,`y`,`x`,1,-1,n,t,-e,a,i,1),p(`x`,`z`,`y`,1,1,e,n,t,r,a,2),p(`x`,`z`,`y`,1,-1,e,n,-t,r,a,3),p(`x`,`y`,`z`,1,-1,e,t,n,r,i,4),p(`x`,`y`,`z`,-1,-1,e,t,-n,r,i,5),this.setIndex(s),this.setAttribute(`position`,new na(c,3)),this.setAttribute(`normal`,new na(l,3)),this.setAttribute(`uv`,new na(u,2));function p(e,t,n,r,i,a,p,m,h,g,_){let v=a/h,y=p/g,b=a/2,x=p/2,S=m/2,C=h+1,w=g+1,T=0,E=0,D=new q;for(let a=0;a<w;a++){let o=a*y-x;for(let s=0;s<C;s++)D[e]=(s*v-b)*r,D[t]=o*i,D[n]=S,c.push(D.x,D.y,D.z),D[e]=0,D[t]=0,D[n]=m>0?1:-1,l.push(D.x,D.y,D.z),u.push(s/h),u.push(1-a/g),T+=1}for(let e=0;e<g;e++)for(let t=0;t<h;t++){let n=d+t+C*e,r=d+t+C*(e+1),i=d+(t+1)+C*(e+1),a=d+(t+1)+C*e;s.push(n,r,a),s.push(r,i,a),E+=6}o.addGroup(f,E,_),f+=E,d+=T}}copy(e){return super.copy(e),this.parameters=Object.assign({},e.parameters),this}static fromJSON(t){return new e(t.width,t.height,t.depth,t.widthSegments,t.heightSegments,t.depthSegments)}},Fo=class e extends ma{constructor(e=1,t=32,n=0,r=Math.PI*2){super(),this.type=`CircleGeometry`,this.parameters={radius:e,segments:t,thetaStart:n,thetaLength:r},t=Math.max(3,t);let i=[],a=[],o=[],s=[],c=new q,l=new K;a.push(0,0,0),o.push(0,0,1),s.push(.5,.5);for(let i=0,u=3;i<=t;i++,u+=3){let d=n+i/t*r;c.x=e*Math.cos(d),c.y=e*Math.sin(d),a.push(c.x,c.y,c.z),o.push(0,0,1),l.x=(a[u]/e+1)/2,l.y=(a[u+1]/e+1)/2,s.push(l.x,l.y)}for(let e=1;e<=t;e++)i.push(e,e+1,0);this.setIndex(i),this.setAttribute(`position`,new na(a,3)),this.setAttribute(`normal`,new na(o,3)),this.setAttribute(`uv`,new na(s,2))}copy(e){return super.copy(e),this.parameters=Object.assign({},e.parameters),this}static fromJSON(t){return new e(t.radius,t.segments,t.thetaStart,t.thetaLength)}},Io=class e extends ma{constructor(e=1,t=1,n=1,r=32,i=1,a=!1,o=0,s=Math.PI*2){super(),this.type=`CylinderGeometry`,this.parameters={radiusTop:e,radiusBottom:t,height:n,radialSegments:r,heightSegments:i,openEnded:a,thetaStart:o,thetaLength:s};let c=this;r=Math.floor(r),i=Math.floor(i);let l=[],u=[],d=[],f=[],p=0,m=[],h=n/2,g=0;_(),a===!1&&(e>0&&v(!0),t>0&&v(!1)),this.setIndex(l),this.setAttribute(`position`,new na(u,3)),this.setAttribute(`normal`,new na(d,3)),this.setAttribute(`uv`,new na(f,2));function _(){let a=new q,_=new q,v=0,y=(t-e)/n;for(let c=0;c<=i;c++){let l=[],g=c/i,v=g*(t-e)+e;for(let e=0;e<=r;e++){let t=e/r,i=t*s+o,c=Math.sin(i),m=Math.cos(i);_.x=v*c,_.y=-g*n+h,_.z=v*m,u.push(_.x,_.y,_.z),a.set(c,y,m).normalize(),d.push(a.x,a.y,a.z),f.push(t,1-g),l.push(p++)}m.push(l)}for(let n=0;n<r;n++)for(let r=0;r<i;r++){let a=m[r][n],o=m[r+1][n],s=m[r+1][n+1],c=m[r][n+1];(e>0||r!==0)&&(l.push(a,o,c),v+=3),(t>0||r!==i-1)&&(l.push(o,s,c),v+=3)}c.addGroup(g,v,0),g+=v}function v(n){let i=p,a=new K,m=new q,_=0,v=n===!0?e:t,y=n===!0?1:-1;for(let e=1;e<=r;e++)u.push(0,h*y,0),d.push(0,y,0),f.push(.5,.5),p++;let b=p;for(let e=0;e<=r;e++){let t=e/r*s+o,n=Math.cos(t),i=Math.sin(t);m.x=v*i,m.y=h*y,m.z=v*n,u.push(m.x,m.y,m.z),d.push(0,y,0),a.x=n*.5+.5,a.y=i*.5*y+.5,f.push(a.x,a.y),p++}for(let e=0;e<r;e++){let t=i+e,r=b+e;n===!0?l.push(r,r+1,t):l.push(r+1,r,t),_+=3}c.addGroup(g,_,n===!0?1:2),g+=_}}copy(e){return super.copy(e),this.parameters=Object.assign({},e.parameters),this}static fromJSON(t){return new e(t.radiusTop,t.radiusBottom,t.height,t.radialSegments,t.heightSegments,t.openEnded,t.thetaStart,t.thetaLength)}},Lo=class e extends Io{constructor(e=1,t=1,n=32,r=1,i=!1,a=0,o=Math.PI*2){super(0,e,t,n,r,i,a,o),this.type=`ConeGeometry`,this.parameters={radius:e,height:t,radialSegments:n,heightSegments:r,openEnded:i,thetaStart:a,thetaLength:o}}static fromJSON(t){return new e(t.radius,t.height,t.radialSegments,t.heightSegments,t.openEnded,t.thetaStart,t.thetaLength)}},Ro=class{constructor(){this.type=`Curve`,this.arcLengthDivisions=200,this.needsUpdate=!1,this.cacheArcLengths=null}getPoint(){U(`Curve: .getPoint() not implemented.`)}getPointAt(e,t){let n=this.getUtoTmapping(e);return this.getPoint(n,t)}getPoints(e=5){let t=[];for(let n=0;n<=e;n++)t.push(this.getPoint(n/e));return t}getSpacedPoints(e=5){let t=[];for(let n=0;n<=e;n++)t.push(this.getPointAt(n/e));return t}getLength(){let e=this.getLengths();return e[e.length-1]}getLengths(e=this.arcLengthDivisions){if(this.cacheArcLengths&&this.cacheArcLengths.length===e+1&&!this.needsUpdate)return this.cacheArcLengths;this.needsUpdate=!1;let t=[],n,r=this.getPoint(0),i=0;t.push(0);for(let a=1;a<=e;a++)n=this.getPoint(a/e),i+=n.distanceTo(r),t.push(i),r=n;return this.cacheArcLengths=t,t}updateArcLengths(){this.needsUpdate=!0,this.getLengths()}getUtoTmapping(e,t=null){let n=this.getLengths(),r=0,i=n.length,a;a=t||e*n[i-1];let o=0,s=i-1,c;for(;o<=s;)if(r=Math.floor(o+(s-o)/2),c=n[r]-a,c<0)o=r+1;else if(c>0)s=r-1;else{s=r;break}if(r=s,n[r]===a)return r/(i-1);let l=n[r],u=n[r+1]-l,d=(a-l)/u;return(r+d)/(i-1)}getTangent(e,t){let n=1e-4,r=e-n,i=e+n;r<0&&(r=0),i>1&&(i=1);let a=this.getPoint(r),o=this.getPoint(i),s=t||(a.isVector2?new K:new q);return s.copy(o).sub(a).normalize(),s}getTangentAt(e,t){let n=this.getUtoTmapping(e);return this.getTangent(n,t)}computeFrenetFrames(e,t=!1){let n=new q,r=[],i=[],a=[],o=new q,s=new Rr;for(let t=0;t<=e;t++){let n=t/e;r[t]=this.getTangentAt(n,new q)}i[0]=new q,a[0]=new q;let c=Number.MAX_VALUE,l=Math.abs(r[0].x),u=Math.abs(r[0].y),d=Math.abs(r[0].z);l<=c&&(c=l,n.set(1,0,0)),u<=c&&(c=u,n.set(0,1,0)),d<=c&&n.set(0,0,1),o.crossVectors(r[0],n).normalize(),i[0].crossVectors(r[0],o),a[0].crossVectors(r[0],i[0]);for(let t=1;t<=e;t++){if(i[t]=i[t-1].clone(),a[t]=a[t-1].clone(),o.crossVectors(r[t-1],r[t]),o.length()>2**-52){o.normalize();let e=Math.acos(G(r[t-1].dot(r[t]),-1,1));i[t].applyMatrix4(s.makeRotationAxis(o,e))}a[t].crossVectors(r[t],i[t])}if(t===!0){let t=Math.acos(G(i[0].dot(i[e]),-1,1));t/=e,r[0].dot(o.crossVectors(i[0],i[e]))>0&&(t=-t);for(let n=1;n<=e;n++)i[n].applyMatrix4(s.makeRotationAxis(r[n],t*n)),a[n].crossVectors(r[n],i[n])}return{tangents:r,normals:i,binormals:a}}clone(){return new this.constructor().copy(this)}copy(e){return this.arcLengthDivisions=e.arcLengthDivisions,this.cacheArcLengths=null,this}toJSON(){let e={metadata:{version:4.7,type:`Curve`,generator:`Curve.toJSON`}};return e.arcLengthDivisions=this.arcLengthDivisions,e.type=this.type,e}fromJSON(e){return this.arcLengthDivisions=e.arcLengthDivisions,this.cacheArcLengths=null,this}},zo=class extends Ro{constructor(e=0,t=0,n=1,r=1,i=0,a=Math.PI*2,o=!1,s=0){super(),this.isEllipseCurve=!0,this.type=`EllipseCurve`,this.aX=e,this.aY=t,this.xRadius=n,this.yRadius=r,this.aStartAngle=i,this.aEndAngle=a,this.aClockwise=o,this.aRotation=s}getPoint(e,t=new K){let n=t,r=Math.PI*2,i=this.aEndAngle-this.aStartAngle,a=Math.abs(i)<2**-52;for(;i<0;)i+=r;for(;i>r;)i-=r;i<2**-52&&(i=a?0:r),this.aClockwise===!0&&!a&&(i===r?i=-r:i-=r);let o=this.aStartAngle+e*i,s=this.aX+this.xRadius*Math.cos(o),c=this.aY+this.yRadius*Math.sin(o);if(this.aRotation!==0){let e=Math.cos(this.aRotation),t=Math.sin(this.aRotation),n=s-this.aX,r=c-this.aY;s=n*e-r*t+this.aX,c=n*t+r*e+this.aY}return n.set(s,c)}copy(e){return super.copy(e),this.aX=e.aX,this.aY=e.aY,this.xRadius=e.xRadius,this.yRadius=e.yRadius,this.aStartAngle=e.aStartAngle,this.aEndAngle=e.aEndAngle,this.aClockwise=e.aClockwise,this.aRotation=e.aRotation,this}toJSON(){let e=super.toJSON();return e.aX=this.aX,e.aY=this.aY,e.xRadius=this.xRadius,e.yRadius=this.yRadius,e.aStartAngle=this.aStartAngle,e.aEndAngle=this.aEndAngle,e.aClockwise=this.aClockwise,e.aRotation=this.aRotation,e}fromJSON(e){return super.fromJSON(e),this.aX=e.aX,this.aY=e.aY,this.xRadius=e.xRadius,this.yRadius=e.yRadius,this.aStartAngle=e.aStartAngle,this.aEndAngle=e.aEndAngle,this.aClockwise=e.aClockwise,this.aRotation=e.aRotation,this}},Bo=class extends zo{constructor(e,t,n,r,i,a){super(e,t,n,n,r,i,a),this.isArcCurve=!0,this.type=`ArcCurve`}};function Vo(){let e=0,t=0,n=0,r=0;function i(i,a,o,s){e=i,t=o,n=-3*i+3*a-2*o-s,r=2*i-2*a+o+s}return{initCatmullRom:function(e,t,n,r,a){i(t,n,a*(n-e),a*(r-t))},initNonuniformCatmullRom:function(e,t,n,r,a,o,s){let c=(t-e)/a-(n-e)/(a+o)+(n-t)/o,l=(n-t)/o-(r-t)/(o+s)+(r-n)/s;c*=o,l*=o,i(t,n,c,l)},calc:function(i){let a=i*i,o=a*i;return e+t*i+n*a+r*o}}}var Ho=new q,Uo=new q,Wo=new Vo,Go=new Vo,Ko=new Vo,qo=class extends Ro{constructor(e=[],t=!1,n=`centripetal`,r=.5){super(),this.isCatmullRomCurve3=!0,this.type=`CatmullRomCurve3`,this.points=e,this.closed=t,this.curveType=n,this.tension=r}getPoint(e,t=new q){let n=t,r=this.points,i=r.length,a=(i-+!this.closed)*e,o=Math.floor(a),s=a-o;this.closed?o+=o>0?0:(Math.floor(Math.abs(o)/i)+1)*i:s===0&&o===i-1&&(o=i-2,s=1);let c,l;this.closed||o>0?c=r[(o-1)%i]:(Uo.subVectors(r[0],r[1]).add(r[0]),c=Uo);let u=r[o%i],d=r[(o+1)%i];if(this.closed||o+2<i?l=r[(o+2)%i]:(Ho.subVectors(r[i-1],r[i-2]).add(r[i-1]),l=Ho),this.curveType===`centripetal`||this.curveType===`chordal`){let e=this.curveType===`chordal`?.5:.25,t=c.distanceToSquared(u)**+e,n=u.distanceToSquared(d)**+e,r=d.distanceToSquared(l)**+e;n<1e-4&&(n=1),t<1e-4&&(t=n),r<1e-4&&(r=n),Wo.initNonuniformCatmullRom(c.x,u.x,d.x,l.x,t,n,r),Go.initNonuniformCatmullRom(c.y,u.y,d.y,l.y,t,n,r),Ko.initNonuniformCatmullRom(c.z,u.z,d.z,l.z,t,n,r)}else this.curveType===`catmullrom`&&(Wo.initCatmullRom(c.x,u.x,d.x,l.x,this.tension),Go.initCatmullRom(c.y,u.y,d.y,l.y,this.tension),Ko.initCatmullRom(c.z,u.z,d.z,l.z,this.tension));return n.set(Wo.calc(s),Go.calc(s),Ko.calc(s)),n}copy(e){super.copy(e),this.points=[];for(let t=0,n=e.points.length;t<n;t++){let n=e.points[t];this.points.push(n.clone())}return this.closed=e.closed,this.curveType=e.curveType,this.tension=e.tension,this}toJSON(){let e=super.toJSON();e.points=[];for(let t=0,n=this.points.length;t<n;t++){let n=this.points[t];e.points.push(n.toArray())}return e.closed=this.closed,e.curveType=this.curveType,e.tension=this.tension,e}fromJSON(e){super.fromJSON(e),this.points=[];for(let t=0,n=e.points.length;t<n;t++){let n=e.points[t];this.points.push(new q().fromArray(n))}return this.closed=e.closed,this.curveType=e.curveType,this.tension=e.tension,this}};function Jo(e,t,n,r,i){let a=(r-t)*.5,o=(i-n)*.5,s=e*e,c=e*s;return(2*n-2*r+a+o)*c+(-3*n+3*r-2*a-o)*s+a*e+n}function Yo(e,t){let n=1-e;return n*n*t}function Xo(e,t){return 2*(1-e)*e*t}function Zo(e,t){return e*e*t}function Qo(e,t,n,r){return Yo(e,t)+Xo(e,n)+Zo(e,r)}function $o(e,t){let n=1-e;return n*n*n*t}function es(e,t){let n=1-e;return 3*n*n*e*t}function ts(e,t){return 3*(1-e)*e*e*t}function ns(e,t){return e*e*e*t}function rs(e,t,n,r,i){return $o(e,t)+es(e,n)+ts(e,r)+ns(e,i)}var is=class extends Ro{constructor(e=new K,t=new K,n=new K,r=new K){super(),this.isCubicBezierCurve=!0,this.type=`CubicBezierCurve`,this.v0=e,this.v1=t,this.v2=n,this.v3=r}getPoint(e,t=new K){let n=t,r=this.v0,i=this.v1,a=this.v2,o=this.v3;return n.set(rs(e,r.x,i.x,a.x,o.x),rs(e,r.y,i.y,a.y,o.y)),n}copy(e){return super.copy(e),this.v0.copy(e.v0),this.v1.copy(e.v1),this.v2.copy(e.v2),this.v3.copy(e.v3),this}toJSON(){let e=super.toJSON();return e.v0=this.v0.toArray(),e.v1=this.v1.toArray(),e.v2=this.v2.toArray(),e.v3=this.v3.toArray(),e}fromJSON(e){return super.fromJSON(e),this.v0.fromArray(e.v0),this.v1.fromArray(e.v1),this.v2.fromArray(e.v2),this.v3.fromArray(e.v3),this}},as=class extends Ro{constructor(e=new q,t=new q,n=new q,r=new q){super(),this.isCubicBezierCurve3=!0,this.type=`CubicBezierCurve3`,this.v0=e,this.v1=t,this.v2=n,this.v3=r}getPoint(e,t=new q){let n=t,r=this.v0,i=this.v1,a=this.v2,o=this.v3;return n.set(rs(e,r.x,i.x,a.x,o.x),rs(e,r.y,i.y,a.y,o.y),rs(e,r.z,i.z,a.z,o.z)),n}copy(e){return super.copy(e),this.v0.copy(e.v0),this.v1.copy(e.v1),this.v2.copy(e.v2),this.v3.copy(e.v3),this}toJSON(){let e=super.toJSON();return e.v0=this.v0.toArray(),e.v1=this.v1.toArray(),e.v2=this.v2.toArray(),e.v3=this.v3.toArray(),e}fromJSON(e){return super.fromJSON(e),this.v0.fromArray(e.v0),this.v1.fromArray(e.v1),this.v2.fromArray(e.v2),this.v3.fromArray(e.v3),this}},os=class extends Ro{constructor(e=new K,t=new K){super(),this.isLineCurve=!0,this.type=`LineCurve`,this.v1=e,this.v2=t}getPoint(e,t=new K){let n=t;return e===1?n.copy(this.v2):(n.copy(this.v2).sub(this.v1),n.multiplyScalar(e).add(this.v1)),n}getPointAt(e,t){return this.getPoint(e,t)}getTangent(e,t=new K){return t.subVectors(this.v2,this.v1).normalize()}getTangentAt(e,t){return this.getTangent(e,t)}copy(e){return super.copy(e),this.v1.copy(e.v1),this.v2.copy(e.v2),this}toJSON(){let e=super.toJSON();return e.v1=this.v1.toArray(),e.v2=this.v2.toArray(),e}fromJSON(e){return super.fromJSON(e),this.v1.fromArray(e.v1),this.v2.fromArray(e.v2),this}},ss=class extends Ro{constructor(e=new q,t=new q){super(),this.isLineCurve3=!0,this.type=`LineCurve3`,this.v1=e,this.v2=t}getPoint(e,t=new q){let n=t;return e===1?n.copy(this.v2):(n.copy(this.v2).sub(this.v1),n.multiplyScalar(e).add(this.v1)),n}getPointAt(e,t){return this.getPoint(e,t)}getTangent(e,t=new q){return t.subVectors(this.v2,this.v1).normalize()}getTangentAt(e,t){return this.getTangent(e,t)}copy(e){return super.copy(e),this.v1.copy(e.v1),this.v2.copy(e.v2),this}toJSON(){let e=super.toJSON();return e.v1=this.v1.toArray(),e.v2=this.v2.toArray(),e}fromJSON(e){return super.fromJSON(e),this.v1.fromArray(e.v1),this.v2.fromArray(e.v2),this}},cs=class extends Ro{constructor(e=new K,t=new K,n=new K){super(),this.isQuadraticBezierCurve=!0,this.type=`QuadraticBezierCurve`,this.v0=e,this.v1=t,this.v2=n}getPoint(e,t=new K){let n=t,r=this.v0,i=this.v1,a=this.v2;return n.set(Qo(e,r.x,i.x,a.x),Qo(e,r.y,i.y,a.y)),n}copy(e){return super.copy(e),this.v0.copy(e.v0),this.v1.copy(e.v1),this.v2.copy(e.v2),this}toJSON(){let e=super.toJSON();return e.v0=this.v0.toArray(),e.v1=this.v1.toArray(),e.v2=this.v2.toArray(),e}fromJSON(e){return super.fromJSON(e),this.v0.fromArray(e.v0),this.v1.fromArray(e.v1),this.v2.fromArray(e.v2),this}},ls=class extends Ro{constructor(e=new q,t=new q,n=new q){super(),this.isQuadraticBezierCurve3=!0,this.type=`QuadraticBezierCurve3`,this.v0=e,this.v1=t,this.v2=n}getPoint(e,t=new q){let n=t,r=this.v0,i=this.v1,a=this.v2;return n.set(Qo(e,r.x,i.x,a.x),Qo(e,r.y,i.y,a.y),Qo(e,r.z,i.z,a.z)),n}copy(e){return super.copy(e),this.v0.copy(e.v0),this.v1.copy(e.v1),this.v2.copy(e.v2),this}toJSON(){let e=super.toJSON();return e.v0=this.v0.toArray(),e.v1=this.v1.toArray(),e.v2=this.v2.toArray(),e}fromJSON(e){return super.fromJSON(e),this.v0.fromArray(e.v0),this.v1.fromArray(e.v1),this.v2.fromArray(e.v2),this}},us=class extends Ro{constructor(e=[]){super(),this.isSplineCurve=!0,this.type=`SplineCurve`,this.points=e}getPoint(e,t=new K){let n=t,r=this.points,i=(r.length-1)*e,a=Math.floor(i),o=i-a,s=r[a===0?a:a-1],c=r[a],l=r[a>r.length-2?r.length-1:a+1],u=r[a>r.length-3?r.length-1:a+2];return n.set(Jo(o,s.x,c.x,l.x,u.x),Jo(o,s.y,c.y,l.y,u.y)),n}copy(e){super.copy(e),this.points=[];for(let t=0,n=e.points.length;t<n;t++){let n=e.points[t];this.points.push(n.clone())}return this}toJSON(){let e=super.toJSON();e.points=[];for(let t=0,n=this.points.length;t<n;t++){let n=this.points[t];e.points.push(n.toArray())}return e}fromJSON(e){super.fromJSON(e),this.points=[];for(let t=0,n=e.points.length;t<n;t++){let n=e.points[t];this.points.push(new K().fromArray(n))}return this}},ds=Object.freeze({__proto__:null,ArcCurve:Bo,CatmullRomCurve3:qo,CubicBezierCurve:is,CubicBezierCurve3:as,EllipseCurve:zo,LineCurve:os,LineCurve3:ss,QuadraticBezierCurve:cs,QuadraticBezierCurve3:ls,SplineCurve:us}),fs=class extends Ro{constructor(){super(),this.type=`CurvePath`,this.curves=[],this.autoClose=!1,this.cacheLengths=null}add(e){this.curves.push(e)}closePath(){let e=this.curves[0].getPoint(0),t=this.curves[this.curves.length-1].getPoint(1);if(!e.equals(t)){let n=e.isVector2===!0?`LineCurve`:`LineCurve3`;this.curves.push(new ds[n](t,e))}return this}getPoint(e,t){let n=e*this.getLength(),r=this.getCurveLengths(),i=0;for(;i<r.length;){if(r[i]>=n){let e=r[i]-n,a=this.curves[i],o=a.getLength(),s=o===0?0:1-e/o;return a.getPointAt(s,t)}i++}return null}getLength(){let e=this.getCurveLengths();return e[e.length-1]}updateArcLengths(){this.needsUpdate=!0,this.cacheLengths=null,this.getCurveLengths()}getCurveLengths(){if(this.cacheLengths&&this.cacheLengths.length===this.curves.length)return this.cacheLengths;let e=[],t=0;for(let n=0,r=this.curves.length;n<r;n++)t+=this.curves[n].getLength(),e.push(t);return this.cacheLengths=e,e}getSpacedPoints(e=40){let t=[];for(let n=0;n<=e;n++)t.push(this.getPoint(n/e));return this.autoClose&&t.push(t[0]),t}getPoints(e=12){let t=[],n;for(let r=0,i=this.curves;r<i.length;r++){let a=i[r],o=a.isEllipseCurve?e*2:a.isLineCurve||a.isLineCurve3?1:a.isSplineCurve?e*a.points.length:e,s=a.getPoints(o);for(let e=0;e<s.length;e++){let r=s[e];n&&n.equals(r)||(t.push(r),n=r)}}return this.autoClose&&t.length>1&&!t[t.length-1].equals(t[0])&&t.push(t[0]),t}copy(e){super.copy(e),this.curves=[];for(let t=0,n=e.curves.length;t<n;t++){let n=e.curves[t];this.curves.push(n.clone())}return this.autoClose=e.autoClose,this.cacheLengths=null,this}toJSON(){let e=super.toJSON();e.autoClose=this.autoClose,e.curves=[];for(let t=0,n=this.curves.length;t<n;t++){let n=this.curves[t];e.curves.push(n.toJSON())}return e}fromJSON(e){super.fromJSON(e),this.autoClose=e.autoClose,this.curves=[];for(let t=0,n=e.curves.length;t<n;t++){let n=e.curves[t];this.curves.push(new ds[n.type]().fromJSON(n))}return this.cacheLengths=null,this}},ps=class extends fs{constructor(e){super(),this.type=`Path`,this.currentPoint=new K,e&&this.setFromPoints(e)}setFromPoints(e){this.moveTo(e[0].x,e[0].y);for(let t=1,n=e.length;t<n;t++)this.lineTo(e[t].x,e[t].y);return this}moveTo(e,t){return this.currentPoint.set(e,t),this}lineTo(e,t){let n=new os(this.currentPoint.clone(),new K(e,t));return this.curves.push(n),this.currentPoint.set(e,t),this}quadraticCurveTo(e,t,n,r){let i=new cs(this.currentPoint.clone(),new K(e,t),new K(n,r));return this.curves.push(i),this.currentPoint.set(n,r),this}bezierCurveTo(e,t,n,r,i,a){let o=new is(this.currentPoint.clone(),new K(e,t),new K(n,r),new K(i,a));return this.curves.push(o),this.currentPoint.set(i,a),this}splineThru(e){let t=new us([this.currentPoint.clone()].concat(e));return this.curves.push(t),this.currentPoint.copy(e[e.length-1]),this}arc(e,t,n,r,i,a){let o=this.currentPoint.x,s=this.currentPoint.y;return this.absarc(e+o,t+s,n,r,i,a),this}absarc(e,t,n,r,i,a){return this.absellipse(e,t,n,n,r,i,a),this}ellipse(e,t,n,r,i,a,o,s){let c=this.currentPoint.x,l=this.currentPoint.y;return this.absellipse(e+c,t+l,n,r,i,a,o,s),this}absellipse(e,t,n,r,i,a,o,s){let c=new zo(e,t,n,r,i,a,o,s);if(this.curves.length>0){let e=c.getPoint(0);e.equals(this.currentPoint)||this.lineTo(e.x,e.y)}this.curves.push(c);let l=c.getPoint(1);return this.currentPoint.copy(l),this}copy(e){return super.copy(e),this.currentPoint.copy(e.currentPoint),this}toJSON(){let e=super.toJSON();return e.currentPoint=this.currentPoint.toArray(),e}fromJSON(e){return super.fromJSON(e),this.currentPoint.fromArray(e.currentPoint),this}},ms=class extends ps{constructor(e){super(e),this.uuid=Kn(),this.type=`Shape`,this.holes=[]}getPointsHoles(e){let t=[];for(let n=0,r=this.holes.length;n<r;n++)t[n]=this.holes[n].getPoints(e);return t}extractPoints(e){return{shape:this.getPoints(e),holes:this.getPointsHoles(e)}}copy(e){super.copy(e),this.holes=[];for(let t=0,n=e.holes.length;t<n;t++){let n=e.holes[t];this.holes.push(n.clone())}return this}toJSON(){let e=super.toJSON();e.uuid=this.uuid,e.holes=[];for(let t=0,n=this.holes.length;t<n;t++){let n=this.holes[t];e.holes.push(n.toJSON())}return e}fromJSON(e){super.fromJSON(e),this.uuid=e.uuid,this.holes=[];for(let t=0,n=e.holes.length;t<n;t++){let n=e.holes[t];this.holes.push(new ps().fromJSON(n))}return this}};function hs(e,t,n=2){let r=t&&t.length,i=r?t[0]*n:e.length,a=gs(e,0,i,n,!0),o=[];if(!a||a.next===a.prev)return o;let s,c,l;if(r&&(a=Cs(e,t,a,n)),e.length>80*n){s=e[0],c=e[1];let t=s,r=c;for(let a=n;a<i;a+=n){let n=e[a],i=e[a+1];n<s&&(s=n),i<c&&(c=i),n>t&&(t=n),i>r&&(r=i)}l=Math.max(t-s,r-c),l=l===0?0:32767/l}return vs(a,o,n,s,c,l,0),o}function gs(e,t,n,r,i){let a;if(i===qs(e,t,n,r)>0)for(let i=t;i<n;i+=r)a=Ws(i/r|0,e[i],e[i+1],a);else for(let i=n-r;i>=t;i-=r)a=Ws(i/r|0,e[i],e[i+1],a);return a&&Is(a,a.next)&&(Gs(a),a=a.next),a}function _s(e,t){if(!e)return e;t||=e;let n=e,r;do if(r=!1,!n.steiner&&(Is(n,n.next)||Fs(n.prev,n,n.next)===0)){if(Gs(n),n=t=n.prev,n===n.next)break;r=!0}else n=n.next;while(r||n!==t);return t}function vs(e,t,n,r,i,a,o){if(!e)return;!o&&a&&Os(e,r,i,a);let s=e;for(;e.prev!==e.next;){let c=e.prev,l=e.next;if(a?bs(e,r,i,a):ys(e))t.push(c.i,e.i,l.i),Gs(e),e=l.next,s=l.next;else if(e=l,e===s){o?o===1?(e=xs(_s(e),t),vs(e,t,n,r,i,a,2)):o===2&&Ss(e,t,n,r,i,a):vs(_s(e),t,n,r,i,a,1);break}}}function ys(e){let t=e.prev,n=e,r=e.next;if(Fs(t,n,r)>=0)return!1;let i=t.x,a=n.x,o=r.x,s=t.y,c=n.y,l=r.y,u=Math.min(i,a,o),d=Math.min(s,c,l),f=Math.max(i,a,o),p=Math.max(s,c,l),m=r.next;for(;m!==t;){if(m.x>=u&&m.x<=f&&m.y>=d&&m.y<=p&&Ns(i,s,a,c,o,l,m.x,m.y)&&Fs(m.prev,m,m.next)>=0)return!1;m=m.next}return!0}function bs(e,t,n,r){let i=e.prev,a=e,o=e.next;if(Fs(i,a,o)>=0)return!1;let s=i.x,c=a.x,l=o.x,u=i.y,d=a.y,f=o.y,p=Math.min(s,c,l),m=Math.min(u,d,f),h=Math.max(s,c,l),g=Math.max(u,d,f),_=As(p,m,t,n,r),v=As(h,g,t,n,r),y=e.prevZ,b=e.nextZ;for(;y&&y.z>=_&&b&&b.z<=v;){if(y.x>=p&&y.x<=h&&y.y>=m&&y.y<=g&&y!==i&&y!==o&&Ns(s,u,c,d,l,f,y.x,y.y)&&Fs(y.prev,y,y.next)>=0||(y=y.prevZ,b.x>=p&&b.x<=h&&b.y>=m&&b.y<=g&&b!==i&&b!==o&&Ns(s,u,c,d,l,f,b.x,b.y)&&Fs(b.prev,b,b.next)>=0))return!1;b=b.nextZ}for(;y&&y.z>=_;){if(y.x>=p&&y.x<=h&&y.y>=m&&y.y<=g&&y!==i&&y!==o&&Ns(s,u,c,d,l,f,y.x,y.y)&&Fs(y.prev,y,y.next)>=0)return!1;y=y.prevZ}for(;b&&b.z<=v;){if(b.x>=p&&b.x<=h&&b.y>=m&&b.y<=g&&b!==i&&b!==o&&Ns(s,u,c,d,l,f,b.x,b.y)&&Fs(b.prev,b,b.next)>=0)return!1;b=b.nextZ}return!0}function xs(e,t){let n=e;do{let r=n.prev,i=n.next.next;!Is(r,i)&&Ls(r,n,n.next,i)&&Vs(r,i)&&Vs(i,r)&&(t.push(r.i,n.i,i.i),Gs(n),Gs(n.next),n=e=i),n=n.next}while(n!==e);return _s(n)}function Ss(e,t,n,r,i,a){let o=e;do{let e=o.next.next;for(;e!==o.prev;){if(o.i!==e.i&&Ps(o,e)){let s=Us(o,e);o=_s(o,o.next),s=_s(s,s.next),vs(o,t,n,r,i,a,0),vs(s,t,n,r,i,a,0);return}e=e.next}o=o.next}while(o!==e)}function Cs(e,t,n,r){let i=[];for(let n=0,a=t.length;n<a;n++){let o=gs(e,t[n]*r,n<a-1?t[n+1]*r:e.length,r,!1);o===o.next&&(o.steiner=!0),i.push(js(o))}i.sort(ws);for(let e=0;e<i.length;e++)n=Ts(i[e],n);return n}function ws(e,t){let n=e.x-t.x;return n===0&&(n=e.y-t.y,n===0&&(n=(e.next.y-e.y)/(e.next.x-e.x)-(t.next.y-t.y)/(t.next.x-t.x))),n}function Ts(e,t){let n=Es(e,t);if(!n)return t;let r=Us(n,e);return _s(r,r.next),_s(n,n.next)}function Es(e,t){let n=t,r=e.x,i=e.y,a=-1/0,o;if(Is(e,n))return n;do{if(Is(e,n.next))return n.next;if(i<=n.y&&i>=n.next.y&&n.next.y!==n.y){let e=n.x+(i-n.y)*(n.next.x-n.x)/(n.next.y-n.y);if(e<=r&&e>a&&(a=e,o=n.x<n.next.x?n:n.next,e===r))return o}n=n.next}while(n!==t);if(!o)return null;let s=o,c=o.x,l=o.y,u=1/0;n=o;do{if(r>=n.x&&n.x>=c&&r!==n.x&&Ms(i<l?r:a,i,c,l,i<l?a:r,i,n.x,n.y)){let t=Math.abs(i-n.y)/(r-n.x);Vs(n,e)&&(t<u||t===u&&(n.x>o.x||n.x===o.x&&Ds(o,n)))&&(o=n,u=t)}n=n.next}while(n!==s);return o}function Ds(e,t){return Fs(e.prev,e,t.prev)<0&&Fs(t.next,e,e.next)<0}function Os(e,t,n,r){let i=e;do i.z===0&&(i.z=As(i.x,i.y,t,n,r)),i.prevZ=i.prev,i.nextZ=i.next,i=i.next;while(i!==e);i.prevZ.nextZ=null,i.prevZ=null,ks(i)}function ks(e){let t,n=1;do{let r=e,i;e=null;let a=null;for(t=0;r;){t++;let o=r,s=0;for(let e=0;e<n&&(s++,o=o.nextZ,o);e++);let c=n;for(;s>0||c>0&&o;)s!==0&&(c===0||!o||r.z<=o.z)?(i=r,r=r.nextZ,s--):(i=o,o=o.nextZ,c--),a?a.nextZ=i:e=i,i.prevZ=a,a=i;r=o}a.nextZ=null,n*=2}while(t>1);return e}function As(e,t,n,r,i){return e=(e-n)*i|0,t=(t-r)*i|0,e=(e|e<<8)&16711935,e=(e|e<<4)&252645135,e=(e|e<<2)&858993459,e=(e|e<<1)&1431655765,t=(t|t<<8)&16711935,t=(t|t<<4)&252645135,t=(t|t<<2)&858993459,t=(t|t<<1)&1431655765,e|t<<1}function js(e){let t=e,n=e;do(t.x<n.x||t.x===n.x&&t.y<n.y)&&(n=t),t=t.next;while(t!==e);return n}function Ms(e,t,n,r,i,a,o,s){return(i-o)*(t-s)>=(e-o)*(a-s)&&(e-o)*(r-s)>=(n-o)*(t-s)&&(n-o)*(a-s)>=(i-o)*(r-s)}function Ns(e,t,n,r,i,a,o,s){return(e!==o||t!==s)&&Ms(e,t,n,r,i,a,o,s)}function Ps(e,t){return e.next.i!==t.i&&e.prev.i!==t.i&&!Bs(e,t)&&(Vs(e,t)&&Vs(t,e)&&Hs(e,t)&&(Fs(e.prev,e,t.prev)||Fs(e,t.prev,t))||Is(e,t)&&Fs(e.prev,e,e.next)>0&&Fs(t.prev,t,t.next)>0)}function Fs(e,t,n){return(t.y-e.y)*(n.x-t.x)-(t.x-e.x)*(n.y-t.y)}function Is(e,t){return e.x===t.x&&e.y===t.y}function Ls(e,t,n,r){let i=zs(Fs(e,t,n)),a=zs(Fs(e,t,r)),o=zs(Fs(n,r,e)),s=zs(Fs(n,r,t));return!!(i!==a&&o!==s||i===0&&Rs(e,n,t)||a===0&&Rs(e,r,t)||o===0&&Rs(n,e,r)||s===0&&Rs(n,t,r))}function Rs(e,t,n){return t.x<=Math.max(e.x,n.x)&&t.x>=Math.min(e.x,n.x)&&t.y<=Math.max(e.y,n.y)&&t.y>=Math.min(e.y,n.y)}function zs(e){return e>0?1:e<0?-1:0}function Bs(e,t){let n=e;do{if(n.i!==e.i&&n.next.i!==e.i&&n.i!==t.i&&n.next.i!==t.i&&Ls(n,n.next,e,t))return!0;n=n.next}while(n!==e);return!1}function Vs(e,t){return Fs(e.prev,e,e.next)<0?Fs(e,t,e.next)>=0&&Fs(e,e.prev,t)>=0:Fs(e,t,e.prev)<0||Fs(e,e.next,t)<0}function Hs(e,t){let n=e,r=!1,i=(e.x+t.x)/2,a=(e.y+t.y)/2;do n.y>a!=n.next.y>a&&n.next.y!==n.y&&i<(n.next.x-n.x)*(a-n.y)/(n.next.y-n.y)+n.x&&(r=!r),n=n.next;while(n!==e);return r}function Us(e,t){let n=Ks(e.i,e.x,e.y),r=Ks(t.i,t.x,t.y),i=e.next,a=t.prev;return e.next=t,t.prev=e,n.next=i,i.prev=n,r.next=n,n.prev=r,a.next=r,r.prev=a,r}function Ws(e,t,n,r){let i=Ks(e,t,n);return r?(i.next=r.next,i.prev=r,r.next.prev=i,r.next=i):(i.prev=i,i.next=i),i}function Gs(e){e.next.prev=e.prev,e.prev.next=e.next,e.prevZ&&(e.prevZ.nextZ=e.nextZ),e.nextZ&&(e.nextZ.prevZ=e.prevZ)}function Ks(e,t,n){return{i:e,x:t,y:n,prev:null,next:null,z:0,prevZ:null,nextZ:null,steiner:!1}}function qs(e,t,n,r){let i=0;for(let a=t,o=n-r;a<n;a+=r)i+=(e[o]-e[a])*(e[a+1]+e[o+1]),o=a;return i}var Js=class{static triangulate(e,t,n=2){return hs(e,t,n)}},Ys=class e{static area(e){let t=e.length,n=0;for(let r=t-1,i=0;i<t;r=i++)n+=e[r].x*e[i].y-e[i].x*e[r].y;return n*.5}static isClockWise(t){return e.area(t)<0}static triangulateShape(e,t){let n=[],r=[],i=[];Xs(e),Zs(n,e);let a=e.length;t.forEach(Xs);for(let e=0;e<t.length;e++)r.push(a),a+=t[e].length,Zs(n,t[e]);let o=Js.triangulate(n,r);for(let e=0;e<o.length;e+=3)i.push(o.slice(e,e+3));return i}};function Xs(e){let t=e.length;t>2&&e[t-1].equals(e[0])&&e.pop()}function Zs(e,t){for(let n=0;n<t.length;n++)e.push(t[n].x),e.push(t[n].y)}var Qs=class e extends ma{constructor(e=1,t=1,n=1,r=1){super(),this.type=`PlaneGeometry`,this.parameters={width:e,height:t,widthSegments:n,heightSegments:r};let i=e/2,a=t/2,o=Math.floor(n),s=Math.floor(r),c=o+1,l=s+1,u=e/o,d=t/s,f=[],p=[],m=[],h=[];for(let e=0;e<l;e++){let t=e*d-a;for(let n=0;n<c;n++){let r=n*u-i;p.push(r,-t,0),m.push(0,0,1),h.push(n/o),h.push(1-e/s)}}for(let e=0;e<s;e++)for(let t=0;t<o;t++){let n=t+c*e,r=t+c*(e+1),i=t+1+c*(e+1),a=t+1+c*e;f.push(n,r,a),f.push(r,i,a)}this.setIndex(f),this.setAttribute(`position`,new na(p,3)),this.setAttribute(`normal`,new na(m,3)),this.setAttribute(`uv`,new na(h,2))}copy(e){return super.copy(e),this.parameters=Object.assign({},e.parameters),this}static fromJSON(t){return new e(t.width,t.height,t.widthSegments,t.heightSegments)}},$s=class e extends ma{constructor(e=.5,t=1,n=32,r=1,i=0,a=Math.PI*2){super(),this.type=`RingGeometry`,this.parameters={innerRadius:e,outerRadius:t,thetaSegments:n,phiSegments:r,thetaStart:i,thetaLength:a},n=Math.max(3,n),r=Math.max(1,r);let o=[],s=[],c=[],l=[],u=e,d=(t-e)/r,f=new q,p=new K;for(let e=0;e<=r;e++){for(let e=0;e<=n;e++){let r=i+e/n*a;f.x=u*Math.cos(r),f.y=u*Math.sin(r),s.push(f.x,f.y,f.z),c.push(0,0,1),p.x=(f.x/t+1)/2,p.y=(f.y/t+1)/2,l.push(p.x,p.y)}u+=d}for(let e=0;e<r;e++){let t=e*(n+1);for(let e=0;e<n;e++){let r=e+t,i=r,a=r+n+1,s=r+n+2,c=r+1;o.push(i,a,c),o.push(a,s,c)}}this.setIndex(o),this.setAttribute(`position`,new na(s,3)),this.setAttribute(`normal`,new na(c,3)),this.setAttribute(`uv`,new na(l,2))}copy(e){return super.copy(e),this.parameters=Object.assign({},e.parameters),this}static fromJSON(t){return new e(t.innerRadius,t.outerRadius,t.thetaSegments,t.phiSegments,t.thetaStart,t.thetaLength)}},ec=class e extends ma{constructor(e=new ms([new K(0,.5),new K(-.5,-.5),new K(.5,-.5)]),t=12){super(),this.type=`ShapeGeometry`,this.parameters={shapes:e,curveSegments:t};let n=[],r=[],i=[],a=[],o=0,s=0;if(Array.isArray(e)===!1)c(e);else for(let t=0;t<e.length;t++)c(e[t]),this.addGroup(o,s,t),o+=s,s=0;this.setIndex(n),this.setAttribute(`position`,new na(r,3)),this.setAttribute(`normal`,new na(i,3)),this.setAttribute(`uv`,new na(a,2));function c(e){let o=r.length/3,c=e.extractPoints(t),l=c.shape,u=c.holes;Ys.isClockWise(l)===!1&&(l=l.reverse());for(let e=0,t=u.length;e<t;e++){let t=u[e];Ys.isClockWise(t)===!0&&(u[e]=t.reverse())}let d=Ys.triangulateShape(l,u);for(let e=0,t=u.length;e<t;e++){let t=u[e];l=l.concat(t)}for(let e=0,t=l.length;e<t;e++){let t=l[e];r.push(t.x,t.y,0),i.push(0,0,1),a.push(t.x,t.y)}for(let e=0,t=d.length;e<t;e++){let t=d[e],r=t[0]+o,i=t[1]+o,a=t[2]+o;n.push(r,i,a),s+=3}}}copy(e){return super.copy(e),this.parameters=Object.assign({},e.parameters),this}toJSON(){let e=super.toJSON(),t=this.parameters.shapes;return tc(t,e)}static fromJSON(t,n){let r=[];for(let e=0,i=t.shapes.length;e<i;e++){let i=n[t.shapes[e]];r.push(i)}return new e(r,t.curveSegments)}};function tc(e,t){if(t.shapes=[],Array.isArray(e))for(let n=0,r=e.length;n<r;n++){let r=e[n];t.shapes.push(r.uuid)}else t.shapes.push(e.uuid);return t}function nc(e){let t={};for(let n in e){t[n]={};for(let r in e[n]){let i=e[n][r];if(ic(i))i.isRenderTargetTexture?(U(`UniformsUtils: Textures of render targets cannot be cloned via cloneUniforms() or mergeUniforms().`),t[n][r]=null):t[n][r]=i.clone();else if(Array.isArray(i)){if(ic(i[0])){let e=[];for(let t=0,n=i.length;t<n;t++)e[t]=i[t].clone();t[n][r]=e}else t[n][r]=i.slice()}else t[n][r]=i}}return t}function rc(e){let t={};for(let n=0;n<e.length;n++){let r=nc(e[n]);for(let e in r)t[e]=r[e]}return t}function ic(e){return e&&(e.isColor||e.isMatrix3||e.isMatrix4||e.isVector2||e.isVector3||e.isVector4||e.isTexture||e.isQuaternion)}function ac(e){let t=[];for(let n=0;n<e.length;n++)t.push(e[n].clone());return t}function oc(e){let t=e.getRenderTarget();return t===null?e.outputColorSpace:t.isXRRenderTarget===!0?t.texture.colorSpace:Sr.workingColorSpace}var sc={clone:nc,merge:rc},cc=`void main() {
	gl_Position = projectionMatrix * modelViewMatrix * vec4( position, 1.0 );
}`,lc=`void main() {
	gl_FragColor = vec4( 1.0, 0.0, 0.0, 1.0 );
}`,uc=class extends wa{constructor(e){super(),this.isShaderMaterial=!0,this.type=`ShaderMaterial`,this.defines={},this.uniforms={},this.uniformsGroups=[],this.vertexShader=cc,this.fragmentShader=lc,this.linewidth=1,this.wireframe=!1,this.wireframeLinewidth=1,this.fog=!1,this.lights=!1,this.clipping=!1,this.forceSinglePass=!0,this.extensions={clipCullDistance:!1,multiDraw:!1},this.defaultAttributeValues={color:[1,1,1],uv:[0,0],uv1:[0,0]},this.index0AttributeName=void 0,this.uniformsNeedUpdate=!1,this.glslVersion=null,e!==void 0&&this.setValues(e)}copy(e){return super.copy(e),this.fragmentShader=e.fragmentShader,this.vertexShader=e.vertexShader,this.uniforms=nc(e.uniforms),this.uniformsGroups=ac(e.uniformsGroups),this.defines=Object.assign({},e.defines),this.wireframe=e.wireframe,this.wireframeLinewidth=e.wireframeLinewidth,this.fog=e.fog,this.lights=e.lights,this.clipping=e.clipping,this.extensions=Object.assign({},e.extensions),this.glslVersion=e.glslVersion,this.defaultAttributeValues=Object.assign({},e.defaultAttributeValues),this.index0AttributeName=e.index0AttributeName,this.uniformsNeedUpdate=e.uniformsNeedUpdate,this}toJSON(e){let t=super.toJSON(e);t.glslVersion=this.glslVersion,t.uniforms={};for(let n in this.uniforms){let r=this.uniforms[n].value;r&&r.isTexture?t.uniforms[n]={type:`t`,value:r.toJSON(e).uuid}:r&&r.isColor?t.uniforms[n]={type:`c`,value:r.getHex()}:r&&r.isVector2?t.uniforms[n]={type:`v2`,value:r.toArray()}:r&&r.isVector3?t.uniforms[n]={type:`v3`,value:r.toArray()}:r&&r.isVector4?t.uniforms[n]={type:`v4`,value:r.toArray()}:r&&r.isMatrix3?t.uniforms[n]={type:`m3`,value:r.toArray()}:r&&r.isMatrix4?t.uniforms[n]={type:`m4`,value:r.toArray()}:t.uniforms[n]={value:r}}Object.keys(this.defines).length>0&&(t.defines=this.defines),t.vertexShader=this.vertexShader,t.fragmentShader=this.fragmentShader,t.lights=this.lights,t.clipping=this.clipping;let n={};for(let e in this.extensions)this.extensions[e]===!0&&(n[e]=!0);return Object.keys(n).length>0&&(t.extensions=n),t}fromJSON(e,t){if(super.fromJSON(e,t),e.uniforms!==void 0)for(let n in e.uniforms){let r=e.uniforms[n];switch(this.uniforms[n]={},r.type){case`t`:this.uniforms[n].value=t[r.value]||null;break;case`c`:this.uniforms[n].value=new Y().setHex(r.value);break;case`v2`:this.uniforms[n].value=new K().fromArray(r.value);break;case`v3`:this.uniforms[n].value=new q().fromArray(r.value);break;case`v4`:this.uniforms[n].value=new Nr().fromArray(r.value);break;case`m3`:this.uniforms[n].value=new J().fromArray(r.value);break;case`m4`:this.uniforms[n].value=new Rr().fromArray(r.value);break;default:this.uniforms[n].value=r.value}}if(e.defines!==void 0&&(this.defines=e.defines),e.vertexShader!==void 0&&(this.vertexShader=e.vertexShader),e.fragmentShader!==void 0&&(this.fragmentShader=e.fragmentShader),e.glslVersion!==void 0&&(this.glslVersion=e.glslVersion),e.extensions!==void 0)for(let t in e.extensions)this.extensions[t]=e.extensions[t];return e.lights!==void 0&&(this.lights=e.lights),e.clipping!==void 0&&(this.clipping=e.clipping),this}},dc=class extends uc{constructor(e){super(e),this.isRawShaderMaterial=!0,this.type=`RawShaderMaterial`}},fc=class extends wa{constructor(e){super(),this.isMeshDepthMaterial=!0,this.type=`MeshDepthMaterial`,this.depthPacking=Sn,this.map=null,this.alphaMap=null,this.displacementMap=null,this.displacementScale=1,this.displacementBias=0,this.wireframe=!1,this.wireframeLinewidth=1,this.setValues(e)}copy(e){return super.copy(e),this.depthPacking=e.depthPacking,this.map=e.map,this.alphaMap=e.alphaMap,this.displacementMap=e.displacementMap,this.displacementScale=e.displacementScale,this.displacementBias=e.displacementBias,this.wireframe=e.wireframe,this.wireframeLinewidth=e.wireframeLinewidth,this}},pc=class extends wa{constructor(e){super(),this.isMeshDistanceMaterial=!0,this.type=`MeshDistanceMaterial`,this.map=null,this.alphaMap=null,this.displacementMap=null,this.displacementScale=1,this.displacementBias=0,this.setValues(e)}copy(e){return super.copy(e),this.map=e.map,this.alphaMap=e.alphaMap,this.displacementMap=e.displacementMap,this.displacementScale=e.displacementScale,this.displacementBias=e.displacementBias,this}};function mc(e,t){return!e||e.constructor===t?e:typeof t.BYTES_PER_ELEMENT==`number`?new t(e):Array.prototype.slice.call(e)}function hc(e){return e!==void 0&&e.inTangents!==void 0&&e.outTangents!==void 0}var gc=class{constructor(e,t,n,r){this.parameterPositions=e,this._cachedIndex=0,this.resultBuffer=r===void 0?new t.constructor(n):r,this.sampleValues=t,this.valueSize=n,this.settings=null,this.DefaultSettings_={}}evaluate(e){let t=this.parameterPositions,n=this._cachedIndex,r=t[n],i=t[n-1];validate_interval:{seek:{let a;linear_scan:{forward_scan:if(!(e<r)){for(let a=n+2;;){if(r===void 0){if(e<i)break forward_scan;return n=t.length,this._cachedIndex=n,this.copySampleValue_(n-1)}if(n===a)break;if(i=r,r=t[++n],e<r)break seek}a=t.length;break linear_scan}if(!(e>=i)){let o=t[1];e<o&&(n=2,i=o);for(let a=n-2;;){if(i===void 0)return this._cachedIndex=0,this.copySampleValue_(0);if(n===a)break;if(r=i,i=t[--n-1],e>=i)break seek}a=n,n=0;break linear_scan}break validate_interval}for(;n<a;){let r=n+a>>>1;e<t[r]?a=r:n=r+1}if(r=t[n],i=t[n-1],i===void 0)return this._cachedIndex=0,this.copySampleValue_(0);if(r===void 0)return n=t.length,this._cachedIndex=n,this.copySampleValue_(n-1)}this._cachedIndex=n,this.intervalChanged_(n,i,r)}return this.interpolate_(n,i,e,r)}getSettings_(){return this.settings||this.DefaultSettings_}copySampleValue_(e){let t=this.resultBuffer,n=this.sampleValues,r=this.valueSize,i=e*r;for(let e=0;e!==r;++e)t[e]=n[i+e];return t}interpolate_(){throw Error(`THREE.Interpolant: Call to abstract method.`)}intervalChanged_(){}},_c=class extends gc{constructor(e,t,n,r){super(e,t,n,r),this._weightPrev=-0,this._offsetPrev=-0,this._weightNext=-0,this._offsetNext=-0,this.DefaultSettings_={endingStart:yn,endingEnd:yn}}intervalChanged_(e,t,n){let r=this.parameterPositions,i=e-2,a=e+1,o=r[i],s=r[a];if(o===void 0)switch(this.getSettings_().endingStart){case bn:i=e,o=2*t-n;break;case xn:i=r.length-2,o=t+r[i]-r[i+1];break;default:i=e,o=n}if(s===void 0)switch(this.getSettings_().endingEnd){case bn:a=e,s=2*n-t;break;case xn:a=1,s=n+r[1]-r[0];break;default:a=e-1,s=t}let c=(n-t)*.5,l=this.valueSize;this._weightPrev=c/(t-o),this._weightNext=c/(s-n),this._offsetPrev=i*l,this._offsetNext=a*l}interpolate_(e,t,n,r){let i=this.resultBuffer,a=this.sampleValues,o=this.valueSize,s=e*o,c=s-o,l=this._offsetPrev,u=this._offsetNext,d=this._weightPrev,f=this._weightNext,p=(n-t)/(r-t),m=p*p,h=m*p,g=-d*h+2*d*m-d*p,_=(1+d)*h+(-1.5-2*d)*m+(-.5+d)*p+1,v=(-1-f)*h+(1.5+f)*m+.5*p,y=f*h-f*m;for(let e=0;e!==o;++e)i[e]=g*a[l+e]+_*a[c+e]+v*a[s+e]+y*a[u+e];return i}},vc=class extends gc{constructor(e,t,n,r){super(e,t,n,r)}interpolate_(e,t,n,r){let i=this.resultBuffer,a=this.sampleValues,o=this.valueSize,s=e*o,c=s-o,l=(n-t)/(r-t),u=1-l;for(let e=0;e!==o;++e)i[e]=a[c+e]*u+a[s+e]*l;return i}},yc=class extends gc{constructor(e,t,n,r){super(e,t,n,r)}interpolate_(e){return this.copySampleValue_(e-1)}},bc=class extends gc{interpolate_(e,t,n,r){let i=this.resultBuffer,a=this.sampleValues,o=this.valueSize,s=e*o,c=s-o,l=this.inTangents,u=this.outTangents;if(!l||!u){let e=(n-t)/(r-t),l=1-e;for(let t=0;t!==o;++t)i[t]=a[c+t]*l+a[s+t]*e;return i}let d=o*2,f=e-1;for(let p=0;p!==o;++p){let o=a[c+p],m=a[s+p],h=f*d+p*2,g=u[h],_=u[h+1],v=e*d+p*2,y=l[v],b=l[v+1],x=Cc(n,t,g,y,r);i[p]=xc(x,o,_,b,m)}return i}};function xc(e,t,n,r,i){let a=1-e;return a*a*a*t+3*a*a*e*n+3*a*e*e*r+e*e*e*i}function Sc(e,t,n,r,i){let a=1-e;return 3*a*a*(n-t)+6*a*e*(r-n)+3*e*e*(i-r)}function Cc(e,t,n,r,i){let a=(e-t)/(i-t);for(let o=0;o<8;o++){let o=xc(a,t,n,r,i)-e;if(Math.abs(o)<1e-10)break;let s=Sc(a,t,n,r,i);if(Math.abs(s)<1e-10)break;a=Math.max(0,Math.min(1,a-o/s))}return a}var wc=class{constructor(e,t,n,r){if(e===void 0)throw Error(`THREE.KeyframeTrack: track name is undefined`);if(t===void 0||t.length===0)throw Error(`THREE.KeyframeTrack: no keyframes in track named `+e);this.name=e,this.times=mc(t,this.TimeBufferType),this.values=mc(n,this.ValueBufferType),this.setInterpolation(r||this.DefaultInterpolation)}static toJSON(e){let t=e.constructor,n;if(t.toJSON!==this.toJSON)n=t.toJSON(e);else{n={name:e.name,times:mc(e.times,Array),values:mc(e.values,Array)};let t=e.getInterpolation();t!==e.DefaultInterpolation&&(n.interpolation=t),hc(e.settings)&&(n.settings={inTangents:mc(e.settings.inTangents,Array),outTangents:mc(e.settings.outTangents,Array)})}return n.type=e.ValueTypeName,n}InterpolantFactoryMethodDiscrete(e){return new yc(this.times,this.values,this.getValueSize(),e)}InterpolantFactoryMethodLinear(e){return new vc(this.times,this.values,this.getValueSize(),e)}InterpolantFactoryMethodSmooth(e){return new _c(this.times,this.values,this.getValueSize(),e)}InterpolantFactoryMethodBezier(e){let t=new bc(this.times,this.values,this.getValueSize(),e);return this.settings&&(t.inTangents=this.settings.inTangents,t.outTangents=this.settings.outTangents),t}setInterpolation(e){let t;switch(e){case hn:t=this.InterpolantFactoryMethodDiscrete;break;case gn:t=this.InterpolantFactoryMethodLinear;break;case _n:t=this.InterpolantFactoryMethodSmooth;break;case vn:t=this.InterpolantFactoryMethodBezier}if(t===void 0){let t=`unsupported interpolation for `+this.ValueTypeName+` keyframe track named `+this.name;if(this.createInterpolant===void 0){if(e!==this.DefaultInterpolation)this.setInterpolation(this.DefaultInterpolation);else throw Error(t)}return U(`KeyframeTrack:`,t),this}return this.createInterpolant=t,this}getInterpolation(){switch(this.createInterpolant){case this.InterpolantFactoryMethodDiscrete:return hn;case this.InterpolantFactoryMethodLinear:return gn;case this.InterpolantFactoryMethodSmooth:return _n;case this.InterpolantFactoryMethodBezier:return vn}}getValueSize(){return this.values.length/this.times.length}shift(e){if(e!==0){let t=this.times;for(let n=0,r=t.length;n!==r;++n)t[n]+=e;hc(this.settings)&&(Tc(this.settings.inTangents,e),Tc(this.settings.outTangents,e))}return this}scale(e){if(e!==1){let t=this.times;for(let n=0,r=t.length;n!==r;++n)t[n]*=e;hc(this.settings)&&(Ec(this.settings.inTangents,e),Ec(this.settings.outTangents,e))}return this}trim(e,t){let n=this.times,r=n.length,i=0,a=r-1;for(;i!==r&&n[i]<e;)++i;for(;a!==-1&&n[a]>t;)--a;if(++a,i!==0||a!==r){i>=a&&(a=Math.max(a,1),i=a-1);let e=this.getValueSize();this.times=n.slice(i,a),this.values=this.values.slice(i*e,a*e)}return this}validate(){let e=!0,t=this.getValueSize();t-Math.floor(t)!==0&&(W(`KeyframeTrack: Invalid value size in track.`,this),e=!1);let n=this.times,r=this.values,i=n.length;i===0&&(W(`KeyframeTrack: Track is empty.`,this),e=!1);let a=null;for(let t=0;t!==i;t++){let r=n[t];if(typeof r==`number`&&isNaN(r)){W(`KeyframeTrack: Time is not a valid number.`,this,t,r),e=!1;break}if(a!==null&&a>r){W(`KeyframeTrack: Out of order keys.`,this,t,r,a),e=!1;break}a=r}if(r!==void 0&&Mn(r))for(let t=0,n=r.length;t!==n;++t){let n=r[t];if(isNaN(n)){W(`KeyframeTrack: Value is not a valid number.`,this,t,n),e=!1;break}}return e}optimize(){let e=this.times.slice(),t=this.values.slice(),n=this.getValueSize(),r=this.getInterpolation()===_n,i=e.length-1,a=1;for(let o=1;o<i;++o){let i=!1,s=e[o];if(s!==e[o+1]&&(o!==1||s!==e[0])){if(r)i=!0;else{let e=o*n,r=e-n,a=e+n;for(let o=0;o!==n;++o){let n=t[e+o];if(n!==t[r+o]||n!==t[a+o]){i=!0;break}}}}if(i){if(o!==a){e[a]=e[o];let r=o*n,i=a*n;for(let e=0;e!==n;++e)t[i+e]=t[r+e]}++a}}if(i>0){e[a]=e[i];for(let e=i*n,r=a*n,o=0;o!==n;++o)t[r+o]=t[e+o];++a}return a===e.length?(this.times=e,this.values=t):(this.times=e.slice(0,a),this.values=t.slice(0,a*n)),this}clone(){let e=this.times.slice(),t=this.values.slice(),n=this.constructor,r=new n(this.name,e,t);return r.createInterpolant=this.createInterpolant,hc(this.settings)&&(r.settings={inTangents:this.settings.inTangents.slice(),outTangents:this.settings.outTangents.slice()}),r}};function Tc(e,t){for(let n=0,r=e.length;n!==r;n+=2)e[n]+=t}function Ec(e,t){for(let n=0,r=e.length;n!==r;n+=2)e[n]*=t}wc.prototype.ValueTypeName=``,wc.prototype.TimeBufferType=Float32Array,wc.prototype.ValueBufferType=Float32Array,wc.prototype.DefaultInterpolation=gn;var Dc=class extends wc{constructor(e,t,n){super(e,t,n)}};Dc.prototype.ValueTypeName=`bool`,Dc.prototype.ValueBufferType=Array,Dc.prototype.DefaultInterpolation=hn,Dc.prototype.InterpolantFactoryMethodLinear=void 0,Dc.prototype.InterpolantFactoryMethodSmooth=void 0;var Oc=class extends wc{constructor(e,t,n,r){super(e,t,n,r)}};Oc.prototype.ValueTypeName=`color`;var kc=class extends wc{constructor(e,t,n,r){super(e,t,n,r)}};kc.prototype.ValueTypeName=`number`;var Ac=class extends gc{constructor(e,t,n,r){super(e,t,n,r)}interpolate_(e,t,n,r){let i=this.resultBuffer,a=this.sampleValues,o=this.valueSize,s=(n-t)/(r-t),c=e*o;for(let e=c+o;c!==e;c+=4)hr.slerpFlat(i,0,a,c-o,a,c,s);return i}},jc=class extends wc{constructor(e,t,n,r){super(e,t,n,r)}InterpolantFactoryMethodLinear(e){return new Ac(this.times,this.values,this.getValueSize(),e)}};jc.prototype.ValueTypeName=`quaternion`,jc.prototype.InterpolantFactoryMethodSmooth=void 0;var Mc=class extends wc{constructor(e,t,n){super(e,t,n)}};Mc.prototype.ValueTypeName=`string`,Mc.prototype.ValueBufferType=Array,Mc.prototype.DefaultInterpolation=hn,Mc.prototype.InterpolantFactoryMethodLinear=void 0,Mc.prototype.InterpolantFactoryMethodSmooth=void 0;var Nc=class extends wc{constructor(e,t,n,r){super(e,t,n,r)}};Nc.prototype.ValueTypeName=`vector`;var Pc=new q,Fc=new hr,Ic=new q,Lc=class extends di{constructor(){super(),this.isCamera=!0,this.type=`Camera`,this.matrixWorldInverse=new Rr,this.projectionMatrix=new Rr,this.projectionMatrixInverse=new Rr,this.coordinateSystem=An,this._reversedDepth=!1}get reversedDepth(){return this._reversedDepth}copy(e,t){return super.copy(e,t),this.matrixWorldInverse.copy(e.matrixWorldInverse),this.projectionMatrix.copy(e.projectionMatrix),this.projectionMatrixInverse.copy(e.projectionMatrixInverse),this.coordinateSystem=e.coordinateSystem,this}getWorldDirection(e){return super.getWorldDirection(e).negate()}updateMatrixWorld(e){super.updateMatrixWorld(e),this.matrixWorld.decompose(Pc,Fc,Ic),Ic.x===1&&Ic.y===1&&Ic.z===1?this.matrixWorldInverse.copy(this.matrixWorld).invert():this.matrixWorldInverse.compose(Pc,Fc,Ic.set(1,1,1)).invert()}updateWorldMatrix(e,t,n=!1){super.updateWorldMatrix(e,t,n),this.matrixWorld.decompose(Pc,Fc,Ic),Ic.x===1&&Ic.y===1&&Ic.z===1?this.matrixWorldInverse.copy(this.matrixWorld).invert():this.matrixWorldInverse.compose(Pc,Fc,Ic.set(1,1,1)).invert()}clone(){return new this.constructor().copy(this)}},Rc=new q,zc=new K,Bc=new K,Vc=class extends Lc{constructor(e=50,t=1,n=.1,r=2e3){super(),this.isPerspectiveCamera=!0,this.type=`PerspectiveCamera`,this.fov=e,this.zoom=1,this.near=n,this.far=r,this.focus=10,this.aspect=t,this.view=null,this.filmGauge=35,this.filmOffset=0,this.updateProjectionMatrix()}copy(e,t){return super.copy(e,t),this.fov=e.fov,this.zoom=e.zoom,this.near=e.near,this.far=e.far,this.focus=e.focus,this.aspect=e.aspect,this.view=e.view===null?null:Object.assign({},e.view),this.filmGauge=e.filmGauge,this.filmOffset=e.filmOffset,this}setFocalLength(e){let t=.5*this.getFilmHeight()/e;this.fov=Gn*2*Math.atan(t),this.updateProjectionMatrix()}getFocalLength(){let e=Math.tan(Wn*.5*this.fov);return .5*this.getFilmHeight()/e}getEffectiveFOV(){return Gn*2*Math.atan(Math.tan(Wn*.5*this.fov)/this.zoom)}getFilmWidth(){return this.filmGauge*Math.min(this.aspect,1)}getFilmHeight(){return this.filmGauge/Math.max(this.aspect,1)}getViewBounds(e,t,n){Rc.set(-1,-1,.5).applyMatrix4(this.projectionMatrixInverse),t.set(Rc.x,Rc.y).multiplyScalar(-e/Rc.z),Rc.set(1,1,.5).applyMatrix4(this.projectionMatrixInverse),n.set(Rc.x,Rc.y).multiplyScalar(-e/Rc.z)}getViewSize(e,t){return this.getViewBounds(e,zc,Bc),t.subVectors(Bc,zc)}setViewOffset(e,t,n,r,i,a){this.aspect=e/t,this.view===null&&(this.view={enabled:!0,fullWidth:1,fullHeight:1,offsetX:0,offsetY:0,width:1,height:1}),this.view.enabled=!0,this.view.fullWidth=e,this.view.fullHeight=t,this.view.offsetX=n,this.view.offsetY=r,this.view.width=i,this.view.height=a,this.updateProjectionMatrix()}clearViewOffset(){this.view!==null&&(this.view.enabled=!1),this.updateProjectionMatrix()}updateProjectionMatrix(){let e=this.near,t=e*Math.tan(Wn*.5*this.fov)/this.zoom,n=2*t,r=this.aspect*n,i=-.5*r,a=this.view;if(this.view!==null&&this.view.enabled){let e=a.fullWidth,o=a.fullHeight;i+=a.offsetX*r/e,t-=a.offsetY*n/o,r*=a.width/e,n*=a.height/o}let o=this.filmOffset;o!==0&&(i+=e*o/this.getFilmWidth()),this.projectionMatrix.makePerspective(i,i+r,t,t-n,e,this.far,this.coordinateSystem,this.reversedDepth),this.projectionMatrixInverse.copy(this.projectionMatrix).invert()}toJSON(e){let t=super.toJSON(e);return t.object.fov=this.fov,t.object.zoom=this.zoom,t.object.near=this.near,t.object.far=this.far,t.object.focus=this.focus,t.object.aspect=this.aspect,this.view!==null&&(t.object.view=Object.assign({},this.view)),t.object.filmGauge=this.filmGauge,t.object.filmOffset=this.filmOffset,t}},Hc=class extends Lc{constructor(e=-1,t=1,n=1,r=-1,i=.1,a=2e3){super(),this.isOrthographicCamera=!0,this.type=`OrthographicCamera`,this.zoom=1,this.view=null,this.left=e,this.right=t,this.top=n,this.bottom=r,this.near=i,this.far=a,this.updateProjectionMatrix()}copy(e,t){return super.copy(e,t),this.left=e.left,this.right=e.right,this.top=e.top,this.bottom=e.bottom,this.near=e.near,this.far=e.far,this.zoom=e.zoom,this.view=e.view===null?null:Object.assign({},e.view),this}setViewOffset(e,t,n,r,i,a){this.view===null&&(this.view={enabled:!0,fullWidth:1,fullHeight:1,offsetX:0,offsetY:0,width:1,height:1}),this.view.enabled=!0,this.view.fullWidth=e,this.view.fullHeight=t,this.view.offsetX=n,this.view.offsetY=r,this.view.width=i,this.view.height=a,this.updateProjectionMatrix()}clearViewOffset(){this.view!==null&&(this.view.enabled=!1),this.updateProjectionMatrix()}updateProjectionMatrix(){let e=(this.right-this.left)/(2*this.zoom),t=(this.top-this.bottom)/(2*this.zoom),n=(this.right+this.left)/2,r=(this.top+this.bottom)/2,i=n-e,a=n+e,o=r+t,s=r-t;if(this.view!==null&&this.view.enabled){let e=(this.right-this.left)/this.view.fullWidth/this.zoom,t=(this.top-this.bottom)/this.view.fullHeight/this.zoom;i+=e*this.view.offsetX,a=i+e*this.view.width,o-=t*this.view.offsetY,s=o-t*this.view.height}this.projectionMatrix.makeOrthographic(i,a,o,s,this.near,this.far,this.coordinateSystem,this.reversedDepth),this.projectionMatrixInverse.copy(this.projectionMatrix).invert()}toJSON(e){let t=super.toJSON(e);return t.object.zoom=this.zoom,t.object.left=this.left,t.object.right=this.right,t.object.top=this.top,t.object.bottom=this.bottom,t.object.near=this.near,t.object.far=this.far,this.view!==null&&(t.object.view=Object.assign({},this.view)),t}},Uc=-90,Wc=1,Gc=class extends di{constructor(e,t,n){super(),this.type=`CubeCamera`,this.renderTarget=n,this.coordinateSystem=null,this.activeMipmapLevel=0;let r=new Vc(Uc,Wc,e,t);r.layers=this.layers,this.add(r);let i=new Vc(Uc,Wc,e,t);i.layers=this.layers,this.add(i);let a=new Vc(Uc,Wc,e,t);a.layers=this.layers,this.add(a);let o=new Vc(Uc,Wc,e,t);o.layers=this.layers,this.add(o);let s=new Vc(Uc,Wc,e,t);s.layers=this.layers,this.add(s);let c=new Vc(Uc,Wc,e,t);c.layers=this.layers,this.add(c)}updateCoordinateSystem(){let e=this.coordinateSystem,t=this.children.concat(),[n,r,i,a,o,s]=t;for(let e of t)this.remove(e);if(e===2e3)n.up.set(0,1,0),n.lookAt(1,0,0),r.up.set(0,1,0),r.lookAt(-1,0,0),i.up.set(0,0,-1),i.lookAt(0,1,0),a.up.set(0,0,1),a.lookAt(0,-1,0),o.up.set(0,1,0),o.lookAt(0,0,1),s.up.set(0,1,0),s.lookAt(0,0,-1);else if(e===2001)n.up.set(0,-1,0),n.lookAt(-1,0,0),r.up.set(0,-1,0),r.lookAt(1,0,0),i.up.set(0,0,1),i.lookAt(0,1,0),a.up.set(0,0,-1),a.lookAt(0,-1,0),o.up.set(0,-1,0),o.lookAt(0,0,1),s.up.set(0,-1,0),s.lookAt(0,0,-1);else throw Error(`THREE.CubeCamera.updateCoordinateSystem(): Invalid coordinate system: `+e);for(let e of t)this.add(e),e.updateMatrixWorld()}update(e,t){this.parent===null&&this.updateMatrixWorld();let{renderTarget:n,activeMipmapLevel:r}=this;this.coordinateSystem!==e.coordinateSystem&&(this.coordinateSystem=e.coordinateSystem,this.updateCoordinateSystem());let[i,a,o,s,c,l]=this.children,u=e.getRenderTarget(),d=e.getActiveCubeFace(),f=e.getActiveMipmapLevel(),p=e.xr.enabled;e.xr.enabled=!1;let m=n.texture.mipmapsAutoUpdate;n.texture.mipmapsAutoUpdate=!1;let h=!1;h=e.isWebGLRenderer===!0?e.state.buffers.depth.getReversed():e.reversedDepthBuffer,e.setRenderTarget(n,0,r),h&&e.autoClear===!1&&e.clearDepth(),e.render(t,i),e.setRenderTarget(n,1,r),h&&e.autoClear===!1&&e.clearDepth(),e.render(t,a),e.setRenderTarget(n,2,r),h&&e.autoClear===!1&&e.clearDepth(),e.render(t,o),e.setRenderTarget(n,3,r),h&&e.autoClear===!1&&e.clearDepth(),e.render(t,s),e.setRenderTarget(n,4,r),h&&e.autoClear===!1&&e.clearDepth(),e.render(t,c),n.texture.mipmapsAutoUpdate=m,e.setRenderTarget(n,5,r),h&&e.autoClear===!1&&e.clearDepth(),e.render(t,l),e.setRenderTarget(u,d,f),e.xr.enabled=p,n.texture.needsPMREMUpdate=!0}},Kc=class extends Vc{constructor(e=[]){super(),this.isArrayCamera=!0,this.isMultiViewCamera=!1,this.cameras=e,this.perCameraFrustumCulled=!1}},qc=`\\[\\]\\.:\\/`,Jc=RegExp(`[\\[\\]\\.:\\/]`,`g`),Yc=`[^\\[\\]\\.:\\/]`,Xc=`[^`+qc.replace(`\\.`,``)+`]`,Zc=`((?:WC+[\\/:])*)`.replace(`WC`,Yc),Qc=`(WCOD+)?`.replace(`WCOD`,Xc),$c=`(?:\\.(WC+)(?:\\[(.+)\\])?)?`.replace(`WC`,Yc),el=`\\.(WC+)(?:\\[(.+)\\])?`.replace(`WC`,Yc),tl=RegExp(`^`+Zc+Qc+$c+el+`$`),nl=[`material`,`materials`,`bones`,`map`],rl=class{constructor(e,t,n){let r=n||il.parseTrackName(t);this._targetGroup=e,this._bindings=e.subscribe_(t,r)}getValue(e,t){this.bind();let n=this._targetGroup.nCachedObjects_,r=this._bindings[n];r!==void 0&&r.getValue(e,t)}setValue(e,t){let n=this._bindings;for(let r=this._targetGroup.nCachedObjects_,i=n.length;r!==i;++r)n[r].setValue(e,t)}bind(){let e=this._bindings;for(let t=this._targetGroup.nCachedObjects_,n=e.length;t!==n;++t)e[t].bind()}unbind(){let e=this._bindings;for(let t=this._targetGroup.nCachedObjects_,n=e.length;t!==n;++t)e[t].unbind()}},il=class e{constructor(t,n,r){this.path=n,this.parsedPath=r||e.parseTrackName(n),this.node=e.findNode(t,this.parsedPath.nodeName),this.rootNode=t,this.getValue=this._getValue_unbound,this.setValue=this._setValue_unbound}static create(t,n,r){return t&&t.isAnimationObjectGroup?new e.Composite(t,n,r):new e(t,n,r)}static sanitizeNodeName(e){return e.replace(/\s/g,`_`).replace(Jc,``)}static parseTrackName(e){let t=tl.exec(e);if(t===null)throw Error(`THREE.PropertyBinding: Cannot parse trackName: `+e);let n={nodeName:t[2],objectName:t[3],objectIndex:t[4],propertyName:t[5],propertyIndex:t[6]},r=n.nodeName&&n.nodeName.lastIndexOf(`.`);if(r!==void 0&&r!==-1){let e=n.nodeName.substring(r+1);nl.indexOf(e)!==-1&&(n.nodeName=n.nodeName.substring(0,r),n.objectName=e)}if(n.propertyName===null||n.propertyName.length===0)throw Error(`THREE.PropertyBinding: can not parse propertyName from trackName: `+e);return n}static findNode(e,t){if(t===void 0||t===``||t===`.`||t===-1||t===e.name||t===e.uuid)return e;if(e.skeleton){let n=e.skeleton.getBoneByName(t);if(n!==void 0)return n}if(e.children){let n=function(e){for(let r=0;r<e.length;r++){let i=e[r];if(i.name===t||i.uuid===t)return i;let a=n(i.children);if(a)return a}return null},r=n(e.children);if(r)return r}return null}_getValue_unavailable(){}_setValue_unavailable(){}_getValue_direct(e,t){e[t]=this.targetObject[this.propertyName]}_getValue_array(e,t){let n=this.resolvedProperty;for(let r=0,i=n.length;r!==i;++r)e[t++]=n[r]}_getValue_arrayElement(e,t){e[t]=this.resolvedProperty[this.propertyIndex]}_getValue_toArray(e,t){this.resolvedProperty.toArray(e,t)}_setValue_direct(e,t){this.targetObject[this.propertyName]=e[t]}_setValue_direct_setNeedsUpdate(e,t){this.targetObject[this.propertyName]=e[t],this.targetObject.needsUpdate=!0}_setValue_direct_setMatrixWorldNeedsUpdate(e,t){this.targetObject[this.propertyName]=e[t],this.targetObject.matrixWorldNeedsUpdate=!0}_setValue_array(e,t){let n=this.resolvedProperty;for(let r=0,i=n.length;r!==i;++r)n[r]=e[t++]}_setValue_array_setNeedsUpdate(e,t){let n=this.resolvedProperty;for(let r=0,i=n.length;r!==i;++r)n[r]=e[t++];this.targetObject.needsUpdate=!0}_setValue_array_setMatrixWorldNeedsUpdate(e,t){let n=this.resolvedProperty;for(let r=0,i=n.length;r!==i;++r)n[r]=e[t++];this.targetObject.matrixWorldNeedsUpdate=!0}_setValue_arrayElement(e,t){this.resolvedProperty[this.propertyIndex]=e[t]}_setValue_arrayElement_setNeedsUpdate(e,t){this.resolvedProperty[this.propertyIndex]=e[t],this.targetObject.needsUpdate=!0}_setValue_arrayElement_setMatrixWorldNeedsUpdate(e,t){this.resolvedProperty[this.propertyIndex]=e[t],this.targetObject.matrixWorldNeedsUpdate=!0}_setValue_fromArray(e,t){this.resolvedProperty.fromArray(e,t)}_setValue_fromArray_setNeedsUpdate(e,t){this.resolvedProperty.fromArray(e,t),this.targetObject.needsUpdate=!0}_setValue_fromArray_setMatrixWorldNeedsUpdate(e,t){this.resolvedProperty.fromArray(e,t),this.targetObject.matrixWorldNeedsUpdate=!0}_getValue_unbound(e,t){this.bind(),this.getValue(e,t)}_setValue_unbound(e,t){this.bind(),this.setValue(e,t)}bind(){let t=this.node,n=this.parsedPath,r=n.objectName,i=n.propertyName,a=n.propertyIndex;if(t||(t=e.findNode(this.rootNode,n.nodeName),this.node=t),this.getValue=this._getValue_unavailable,this.setValue=this._setValue_unavailable,!t){U(`PropertyBinding: No target node found for track: `+this.path+`.`);return}if(r){let e=n.objectIndex;switch(r){case`materials`:if(!t.material){W(`PropertyBinding: Can not bind to material as node does not have a material.`,this);return}if(!t.material.materials){W(`PropertyBinding: Can not bind to material.materials as node.material does not have a materials array.`,this);return}t=t.material.materials;break;case`bones`:if(!t.skeleton){W(`PropertyBinding: Can not bind to bones as node does not have a skeleton.`,this);return}t=t.skeleton.bones;for(let n=0;n<t.length;n++)if(t[n].name===e){e=n;break}break;case`map`:if(`map`in t){t=t.map;break}if(!t.material){W(`PropertyBinding: Can not bind to material as node does not have a material.`,this);return}if(!t.material.map){W(`PropertyBinding: Can not bind to material.map as node.material does not have a map.`,this);return}t=t.material.map;break;default:if(t[r]===void 0){W(`PropertyBinding: Can not bind to objectName of node undefined.`,this);return}t=t[r]}if(e!==void 0){if(t[e]===void 0){W(`PropertyBinding: Trying to bind to objectIndex of objectName, but is undefined.`,this,t);return}t=t[e]}}let o=t[i];if(o===void 0){let e=n.nodeName;W(`PropertyBinding: Trying to update property for track: `+e+`.`+i+` but it wasn't found.`,t);return}let s=this.Versioning.None;this.targetObject=t,t.isMaterial===!0?s=this.Versioning.NeedsUpdate:t.isObject3D===!0&&(s=this.Versioning.MatrixWorldNeedsUpdate);let c=this.BindingType.Direct;if(a!==void 0){if(i===`morphTargetInfluences`){if(!t.geometry){W(`PropertyBinding: Can not bind to morphTargetInfluences because node does not have a geometry.`,this);return}if(!t.geometry.morphAttributes){W(`PropertyBinding: Can not bind to morphTargetInfluences because node does not have a geometry.morphAttributes.`,this);return}t.morphTargetDictionary[a]!==void 0&&(a=t.morphTargetDictionary[a])}c=this.BindingType.ArrayElement,this.resolvedProperty=o,this.propertyIndex=a}else o.fromArray!==void 0&&o.toArray!==void 0?(c=this.BindingType.HasFromToArray,this.resolvedProperty=o):Array.isArray(o)?(c=this.BindingType.EntireArray,this.resolvedProperty=o):this.propertyName=i;this.getValue=this.GetterByBindingType[c],this.setValue=this.SetterByBindingTypeAndVersioning[c][s]}unbind(){this.node=null,this.getValue=this._getValue_unbound,this.setValue=this._setValue_unbound}};il.Composite=rl,il.prototype.BindingType={Direct:0,EntireArray:1,ArrayElement:2,HasFromToArray:3},il.prototype.Versioning={None:0,NeedsUpdate:1,MatrixWorldNeedsUpdate:2},il.prototype.GetterByBindingType=[il.prototype._getValue_direct,il.prototype._getValue_array,il.prototype._getValue_arrayElement,il.prototype._getValue_toArray],il.prototype.SetterByBindingTypeAndVersioning=[[il.prototype._setValue_direct,il.prototype._setValue_direct_setNeedsUpdate,il.prototype._setValue_direct_setMatrixWorldNeedsUpdate],[il.prototype._setValue_array,il.prototype._setValue_array_setNeedsUpdate,il.prototype._setValue_array_setMatrixWorldNeedsUpdate],[il.prototype._setValue_arrayElement,il.prototype._setValue_arrayElement_setNeedsUpdate,il.prototype._setValue_arrayElement_setMatrixWorldNeedsUpdate],[il.prototype._setValue_fromArray,il.prototype._setValue_fromArray_setNeedsUpdate,il.prototype._setValue_fromArray_setMatrixWorldNeedsUpdate]];var al=class{constructor(e=1,t=0,n=0){this.radius=e,this.phi=t,this.theta=n}set(e,t,n){return this.radius=e,this.phi=t,this.theta=n,this}copy(e){return this.radius=e.radius,this.phi=e.phi,this.theta=e.theta,this}makeSafe(){let e=1e-6;return this.phi=G(this.phi,e,Math.PI-e),this}setFromVector3(e){return this.setFromCartesianCoords(e.x,e.y,e.z)}setFromCartesianCoords(e,t,n){return this.radius=Math.sqrt(e*e+t*t+n*n),this.radius===0?(this.theta=0,this.phi=0):(this.theta=Math.atan2(e,n),this.phi=Math.acos(G(t/this.radius,-1,1))),this}clone(){return new this.constructor().copy(this)}};(class{static{this.prototype.isMatrix2=!0}constructor(e,t,n,r){this.elements=[1,0,0,1],e!==void 0&&this.set(e,t,n,r)}identity(){return this.set(1,0,0,1),this}fromArray(e,t=0){for(let n=0;n<4;n++)this.elements[n]=e[n+t];return this}set(e,t,n,r){let i=this.elements;return i[0]=e,i[2]=t,i[1]=n,i[3]=r,this}});var ol=new q,sl=new q,cl=new q,ll=new q,ul=new q,dl=new q,fl=new q,pl=class{constructor(e=new q,t=new q){this.start=e,this.end=t}set(e,t){return this.start.copy(e),this.end.copy(t),this}copy(e){return this.start.copy(e.start),this.end.copy(e.end),this}getCenter(e){return e.addVectors(this.start,this.end).multiplyScalar(.5)}delta(e){return e.subVectors(this.end,this.start)}distanceSq(){return this.start.distanceToSquared(this.end)}distance(){return this.start.distanceTo(this.end)}at(e,t){return this.delta(t).multiplyScalar(e).add(this.start)}closestPointToPointParameter(e,t){ol.subVectors(e,this.start),sl.subVectors(this.end,this.start);let n=sl.dot(sl);if(n===0)return 0;let r=sl.dot(ol)/n;return t&&(r=G(r,0,1)),r}closestPointToPoint(e,t,n){let r=this.closestPointToPointParameter(e,t);return this.delta(n).multiplyScalar(r).add(this.start)}distanceSqToLine3(e,t=dl,n=fl){let r=1e-8*1e-8,i,a,o=this.start,s=e.start,c=this.end,l=e.end;cl.subVectors(c,o),ll.subVectors(l,s),ul.subVectors(o,s);let u=cl.dot(cl),d=ll.dot(ll),f=ll.dot(ul);if(u<=r&&d<=r)return t.copy(o),n.copy(s),t.distanceToSquared(n);if(u<=r)i=0,a=f/d,a=G(a,0,1);else{let e=cl.dot(ul);if(d<=r)a=0,i=G(-e/u,0,1);else{let t=cl.dot(ll),n=u*d-t*t;i=n===0?0:G((t*f-e*d)/n,0,1),a=(t*i+f)/d,a<0?(a=0,i=G(-e/u,0,1)):a>1&&(a=1,i=G((t-e)/u,0,1))}}return t.copy(o).addScaledVector(cl,i),n.copy(s).addScaledVector(ll,a),t.distanceToSquared(n)}applyMatrix4(e){return this.start.applyMatrix4(e),this.end.applyMatrix4(e),this}equals(e){return e.start.equals(this.start)&&e.end.equals(this.end)}clone(){return new this.constructor().copy(this)}},ml=class extends Vn{constructor(e,t=null){super(),this.object=e,this.domElement=t,this.enabled=!0,this.state=-1,this.keys={},this.mouseButtons={LEFT:null,MIDDLE:null,RIGHT:null},this.touches={ONE:null,TWO:null}}connect(e){this.domElement!==null&&this.disconnect(),this.domElement=e}disconnect(){}dispose(){}update(){}};function hl(e,t,n,r){let i=gl(r);switch(n){case St:return e*t;case Dt:return e*t/i.components*i.byteLength;case Ot:return e*t/i.components*i.byteLength;case kt:return e*t*2/i.components*i.byteLength;case At:return e*t*2/i.components*i.byteLength;case Ct:return e*t*3/i.components*i.byteLength;case wt:return e*t*4/i.components*i.byteLength;case jt:return e*t*4/i.components*i.byteLength;case Mt:case Nt:return Math.floor((e+3)/4)*Math.floor((t+3)/4)*8;case Pt:case Ft:return Math.floor((e+3)/4)*Math.floor((t+3)/4)*16;case Lt:case zt:return Math.max(e,16)*Math.max(t,8)/4;case It:case Rt:return Math.max(e,8)*Math.max(t,8)/2;case Bt:case Vt:case Ut:case Wt:return Math.floor((e+3)/4)*Math.floor((t+3)/4)*8;case Ht:case Gt:case Kt:return Math.floor((e+3)/4)*Math.floor((t+3)/4)*16;case qt:return Math.floor((e+3)/4)*Math.floor((t+3)/4)*16;case Jt:return Math.floor((e+4)/5)*Math.floor((t+3)/4)*16;case Yt:return Math.floor((e+4)/5)*Math.floor((t+4)/5)*16;case Xt:return Math.floor((e+5)/6)*Math.floor((t+4)/5)*16;case Zt:return Math.floor((e+5)/6)*Math.floor((t+5)/6)*16;case Qt:return Math.floor((e+7)/8)*Math.floor((t+4)/5)*16;case $t:return Math.floor((e+7)/8)*Math.floor((t+5)/6)*16;case en:return Math.floor((e+7)/8)*Math.floor((t+7)/8)*16;case tn:return Math.floor((e+9)/10)*Math.floor((t+4)/5)*16;case nn:return Math.floor((e+9)/10)*Math.floor((t+5)/6)*16;case rn:return Math.floor((e+9)/10)*Math.floor((t+7)/8)*16;case an:return Math.floor((e+9)/10)*Math.floor((t+9)/10)*16;case on:return Math.floor((e+11)/12)*Math.floor((t+9)/10)*16;case sn:return Math.floor((e+11)/12)*Math.floor((t+11)/12)*16;case cn:case ln:case un:return Math.ceil(e/4)*Math.ceil(t/4)*16;case dn:case fn:return Math.ceil(e/4)*Math.ceil(t/4)*8;case pn:case mn:return Math.ceil(e/4)*Math.ceil(t/4)*16}throw Error(`Unable to determine texture byte length for ${n} format.`)}function gl(e){switch(e){case lt:case ut:return{byteLength:1,components:1};case ft:case dt:case gt:return{byteLength:2,components:1};case _t:case vt:return{byteLength:2,components:4};case mt:case pt:case ht:return{byteLength:4,components:1};case bt:case xt:return{byteLength:4,components:3}}throw Error(`THREE.TextureUtils: Unknown texture type ${e}.`)}typeof __THREE_DEVTOOLS__<`u`&&__THREE_DEVTOOLS__.dispatchEvent(new CustomEvent(`register`,{detail:{revision:`187`}})),typeof window<`u`&&(window.__THREE__?U(`WARNING: Multiple instances of Three.js being imported.`):window.__THREE__=`187`);function _l(){let e=null,t=!1,n=null,r=null;function i(t,a){r=e.requestAnimationFrame(i),n(t,a)}return{start:function(){t!==!0&&n!==null&&e!==null&&(r=e.requestAnimationFrame(i),t=!0)},stop:function(){e!==null&&e.cancelAnimationFrame(r),t=!1},setAnimationLoop:function(e){n=e},setContext:function(t){e=t}}}function vl(e){let t=new WeakMap;function n(t,n){let r=t.array,i=t.usage,a=r.byteLength,o=e.createBuffer();e.bindBuffer(n,o),e.bufferData(n,r,i),t.onUploadCallback();let s;if(r instanceof Float32Array)s=e.FLOAT;else if(typeof Float16Array<`u`&&r instanceof Float16Array)s=e.HALF_FLOAT;else if(r instanceof Uint16Array)s=t.isFloat16BufferAttribute?e.HALF_FLOAT:e.UNSIGNED_SHORT;else if(r instanceof Int16Array)s=e.SHORT;else if(r instanceof Uint32Array)s=e.UNSIGNED_INT;else if(r instanceof Int32Array)s=e.INT;else if(r instanceof Int8Array)s=e.BYTE;else if(r instanceof Uint8Array)s=e.UNSIGNED_BYTE;else if(r instanceof Uint8ClampedArray)s=e.UNSIGNED_BYTE;else throw Error(`THREE.WebGLAttributes: Unsupported buffer data format: `+r);return{buffer:o,type:s,bytesPerElement:r.BYTES_PER_ELEMENT,version:t.version,size:a}}function r(t,n,r){let i=n.array,a=n.updateRanges;if(e.bindBuffer(r,t),a.length===0)e.bufferSubData(r,0,i);else{a.sort((e,t)=>e.start-t.start);let t=0;for(let e=1;e<a.length;e++){let n=a[t],r=a[e];r.start<=n.start+n.count+1?n.count=Math.max(n.count,r.start+r.count-n.start):(++t,a[t]=r)}a.length=t+1;for(let t=0,n=a.length;t<n;t++){let n=a[t];e.bufferSubData(r,n.start*i.BYTES_PER_ELEMENT,i,n.start,n.count)}n.clearUpdateRanges()}n.onUploadCallback()}function i(e){return e.isInterleavedBufferAttribute&&(e=e.data),t.get(e)}function a(n){n.isInterleavedBufferAttribute&&(n=n.data);let r=t.get(n);r&&(e.deleteBuffer(r.buffer),t.delete(n))}function o(e,i){if(e.isInterleavedBufferAttribute&&(e=e.data),e.isGLBufferAttribute){let n=t.get(e);(!n||n.version<e.version)&&t.set(e,{buffer:e.buffer,type:e.type,bytesPerElement:e.elementSize,version:e.version});return}let a=t.get(e);if(a===void 0)t.set(e,n(e,i));else if(a.version<e.version){if(a.size!==e.array.byteLength)throw Error(`THREE.WebGLAttributes: The size of the buffer attribute's array buffer does not match the original size. Resizing buffer attributes is not supported.`);r(a.buffer,e,i),a.version=e.version}}return{get:i,remove:a,update:o}}var X={alphahash_fragment:`#ifdef USE_ALPHAHASH
	if ( diffuseColor.a < getAlphaHashThreshold( vPosition ) ) discard;
#endif`,alphahash_pars_fragment:`#ifdef USE_ALPHAHASH
	const float ALPHA_HASH_SCALE = 0.05;
	float hash2D( vec2 value ) {
		return fract( 1.0e4 * sin( 17.0 * value.x + 0.1 * value.y ) * ( 0.1 + abs( sin( 13.0 * value.y + value.x ) ) ) );
	}
	float hash3D( vec3 value ) {
		return hash2D( vec2( hash2D( value.xy ), value.z ) );
	}
	float getAlphaHashThreshold( vec3 position ) {
		float maxDeriv = max(
			length( dFdx( position.xyz ) ),
			length( dFdy( position.xyz ) )
		);
		float pixScale = 1.0 / ( ALPHA_HASH_SCALE * maxDeriv );
		vec2 pixScales = vec2(
			exp2( floor( log2( pixScale ) ) ),
			exp2( ceil( log2( pixScale ) ) )
		);
		vec2 alpha = vec2(
			hash3D( floor( pixScales.x * position.xyz ) ),
			hash3D( floor( pixScales.y * position.xyz ) )
		);
		float lerpFactor = fract( log2( pixScale ) );
		float x = ( 1.0 - lerpFactor ) * alpha.x + lerpFactor * alpha.y;
		float a = min( lerpFactor, 1.0 - lerpFactor );
		vec3 cases = vec3(
			x * x / ( 2.0 * a * ( 1.0 - a ) ),
			( x - 0.5 * a ) / ( 1.0 - a ),
			1.0 - ( ( 1.0 - x ) * ( 1.0 - x ) / ( 2.0 * a * ( 1.0 - a ) ) )
		);
		float threshold = ( x < ( 1.0 - a ) )
			? ( ( x < a ) ? cases.x : cases.y )
			: cases.z;
		return clamp( threshold , 1.0e-6, 1.0 );
	}
#endif`,alphamap_fragment:`#ifdef USE_ALPHAMAP
	diffuseColor.a *= texture2D( alphaMap, vAlphaMapUv ).g;
#endif`,alphamap_pars_fragment:`#ifdef USE_ALPHAMAP
	uniform sampler2D alphaMap;
#endif`,alphatest_fragment:`#ifdef USE_ALPHATEST
	#ifdef ALPHA_TO_COVERAGE
	diffuseColor.a = smoothstep( alphaTest, alphaTest + fwidth( diffuseColor.a ), diffuseColor.a );
	if ( diffuseColor.a == 0.0 ) discard;
	#else
	if ( diffuseColor.a < alphaTest ) discard;
	#endif
#endif`,alphatest_pars_fragment:`#ifdef USE_ALPHATEST
	uniform float alphaTest;
#endif`,aomap_fragment:`#ifdef USE_AOMAP
	float ambientOcclusion = ( texture2D( aoMap, vAoMapUv ).r - 1.0 ) * aoMapIntensity + 1.0;
	reflectedLight.indirectDiffuse *= ambientOcclusion;
	#if defined( USE_CLEARCOAT ) 
		clearcoatSpecularIndirect *= ambientOcclusion;
	#endif
	#if defined( USE_SHEEN ) 
		sheenSpecularIndirect *= ambientOcclusion;
	#endif
	#if defined( USE_ENVMAP ) && defined( STANDARD )
		float dotNV = saturate( dot( geometryNormal, geometryViewDir ) );
		reflectedLight.indirectSpecular *= computeSpecularOcclusion( dotNV, ambientOcclusion, material.roughness );
	#endif
#endif`,aomap_pars_fragment:`#ifdef USE_AOMAP
	uniform sampler2D aoMap;
	uniform float aoMapIntensity;
#endif`,batching_pars_vertex:`#ifdef USE_BATCHING
	#if ! defined( GL_ANGLE_multi_draw )
	#define gl_DrawID _gl_DrawID
	uniform int _gl_DrawID;
	#endif
	uniform highp sampler2D batchingTexture;
	uniform highp usampler2D batchingIdTexture;
	mat4 getBatchingMatrix( const in float i ) {
		int size = textureSize( batchingTexture, 0 ).x;
		int j = int( i ) * 4;
		int x = j % size;
		int y = j / size;
		vec4 v1 = texelFetch( batchingTexture, ivec2( x, y ), 0 );
		vec4 v2 = texelFetch( batchingTexture, ivec2( x + 1, y ), 0 );
		vec4 v3 = texelFetch( batchingTexture, ivec2( x + 2, y ), 0 );
		vec4 v4 = texelFetch( batchingTexture, ivec2( x + 3, y ), 0 );
		return mat4( v1, v2, v3, v4 );
	}
	float getIndirectIndex( const in int i ) {
		int size = textureSize( batchingIdTexture, 0 ).x;
		int x = i % size;
		int y = i / size;
		return float( texelFetch( batchingIdTexture, ivec2( x, y ), 0 ).r );
	}
#endif
#ifdef USE_BATCHING_COLOR
	uniform sampler2D batchingColorTexture;
	vec4 getBatchingColor( const in float i ) {
		int size = textureSize( batchingColorTexture, 0 ).x;
		int j = int( i );
		int x = j % size;
		int y = j / size;
		return texelFetch( batchingColorTexture, ivec2( x, y ), 0 );
	}
#endif`,batching_vertex:`#ifdef USE_BATCHING
	mat4 batchingMatrix = getBatchingMatrix( getIndirectIndex( gl_DrawID ) );
#endif`,begin_vertex:`vec3 transformed = vec3( position );
#ifdef USE_ALPHAHASH
	vPosition = vec3( position );
#endif`,beginnormal_vertex:`vec3 objectNormal = vec3( normal );
#ifdef USE_TANGENT
	vec3 objectTangent = vec3( tangent.xyz );
#endif`,bsdfs:`float G_BlinnPhong_Implicit( ) {
	return 0.25;
}
float D_BlinnPhong( const in float shininess, const in float dotNH ) {
	return RECIPROCAL_PI * ( shininess * 0.5 + 1.0 ) * pow( dotNH, shininess );
}
vec3 BRDF_BlinnPhong( const in vec3 lightDir, const in vec3 viewDir, const in vec3 normal, const in vec3 specularColor, const in float shininess ) {
	vec3 halfDir = normalize( lightDir + viewDir );
	float dotNH = saturate( dot( normal, halfDir ) );
	float dotVH = saturate( dot( viewDir, halfDir ) );
	vec3 F = F_Schlick( specularColor, 1.0, dotVH );
	float G = G_BlinnPhong_Implicit( );
	float D = D_BlinnPhong( shininess, dotNH );
	return F * ( G * D );
} // validated`,iridescence_fragment:`#ifdef USE_IRIDESCENCE
	const mat3 XYZ_TO_REC709 = mat3(
		 3.2404542, -0.9692660,  0.0556434,
		-1.5371385,  1.8760108, -0.2040259,
		-0.4985314,  0.0415560,  1.0572252
	);
	vec3 Fresnel0ToIor( vec3 fresnel0 ) {
		vec3 sqrtF0 = sqrt( fresnel0 );
		return ( vec3( 1.0 ) + sqrtF0 ) / ( vec3( 1.0 ) - sqrtF0 );
	}
	vec3 IorToFresnel0( vec3 transmittedIor, float incidentIor ) {
		return pow2( ( transmittedIor - vec3( incidentIor ) ) / ( transmittedIor + vec3( incidentIor ) ) );
	}
	float IorToFresnel0( float transmittedIor, float incidentIor ) {
		return pow2( ( transmittedIor - incidentIor ) / ( transmittedIor + incidentIor ));
	}
	vec3 evalSensitivity( float OPD, vec3 shift ) {
		float phase = 2.0 * PI * OPD * 1.0e-9;
		vec3 val = vec3( 5.4856e-13, 4.4201e-13, 5.2481e-13 );
		vec3 pos = vec3( 1.6810e+06, 1.7953e+06, 2.2084e+06 );
		vec3 var = vec3( 4.3278e+09, 9.3046e+09, 6.6121e+09 );
		vec3 xyz = val * sqrt( 2.0 * PI * var ) * cos( pos * phase + shift ) * exp( - pow2( phase ) * var );
		xyz.x += 9.7470e-14 * sqrt( 2.0 * PI * 4.5282e+09 ) * cos( 2.2399e+06 * phase + shift[ 0 ] ) * exp( - 4.5282e+09 * pow2( phase ) );
		xyz /= 1.0685e-7;
		vec3 rgb = XYZ_TO_REC709 * xyz;
		return rgb;
	}
	vec3 evalIridescence( float outsideIOR, float eta2, float cosTheta1, float thinFilmThickness, vec3 baseF0 ) {
		vec3 I;
		float iridescenceIOR = mix( outsideIOR, eta2, smoothstep( 0.0, 0.03, thinFilmThickness ) );
		float sinTheta2Sq = pow2( outsideIOR / iridescenceIOR ) * ( 1.0 - pow2( cosTheta1 ) );
		float cosTheta2Sq = 1.0 - sinTheta2Sq;
		if ( cosTheta2Sq < 0.0 ) {
			return vec3( 1.0 );
		}
		float cosTheta2 = sqrt( cosTheta2Sq );
		float R0 = IorToFresnel0( iridescenceIOR, outsideIOR );
		float R12 = F_Schlick( R0, 1.0, cosTheta1 );
		float T121 = 1.0 - R12;
		float phi12 = 0.0;
		if ( iridescenceIOR < outsideIOR ) phi12 = PI;
		float phi21 = PI - phi12;
		vec3 baseIOR = Fresnel0ToIor( clamp( baseF0, 0.0, 0.9999 ) );		vec3 R1 = IorToFresnel0( baseIOR, iridescenceIOR );
		vec3 R23 = F_Schlick( R1, 1.0, cosTheta2 );
		vec3 phi23 = vec3( 0.0 );
		if ( baseIOR[ 0 ] < iridescenceIOR ) phi23[ 0 ] = PI;
		if ( baseIOR[ 1 ] < iridescenceIOR ) phi23[ 1 ] = PI;
		if ( baseIOR[ 2 ] < iridescenceIOR ) phi23[ 2 ] = PI;
		float OPD = 2.0 * iridescenceIOR * thinFilmThickness * cosTheta2;
		vec3 phi = vec3( phi21 ) + phi23;
		vec3 R123 = clamp( R12 * R23, 1e-5, 0.9999 );
		vec3 r123 = sqrt( R123 );
		vec3 Rs = pow2( T121 ) * R23 / ( vec3( 1.0 ) - R123 );
		vec3 C0 = R12 + Rs;
		I = C0;
		vec3 Cm = Rs - T121;
		for ( int m = 1; m <= 2; ++ m ) {
			Cm *= r123;
			vec3 Sm = 2.0 * evalSensitivity( float( m ) * OPD, float( m ) * phi );
			I += Cm * Sm;
		}
		return max( I, vec3( 0.0 ) );
	}
#endif`,bumpmap_pars_fragment:`#ifdef USE_BUMPMAP
	uniform sampler2D bumpMap;
	uniform float bumpScale;
	vec2 dHdxy_fwd() {
		vec2 dSTdx = dFdx( vBumpMapUv );
		vec2 dSTdy = dFdy( vBumpMapUv );
		float Hll = bumpScale * texture2D( bumpMap, vBumpMapUv ).x;
		float dBx = bumpScale * texture2D( bumpMap, vBumpMapUv + dSTdx ).x - Hll;
		float dBy = bumpScale * texture2D( bumpMap, vBumpMapUv + dSTdy ).x - Hll;
		return vec2( dBx, dBy );
	}
	vec3 perturbNormalArb( vec3 surf_pos, vec3 surf_norm, vec2 dHdxy, float faceDirection ) {
		vec3 vSigmaX = normalize( dFdx( surf_pos.xyz ) );
		vec3 vSigmaY = normalize( dFdy( surf_pos.xyz ) );
		vec3 vN = surf_norm;
		vec3 R1 = cross( vSigmaY, vN );
		vec3 R2 = cross( vN, vSigmaX );
		float fDet = dot( vSigmaX, R1 ) * faceDirection;
		vec3 vGrad = sign( fDet ) * ( dHdxy.x * R1 + dHdxy.y * R2 );
		return normalize( abs( fDet ) * surf_norm - vGrad );
	}
#endif`,clipping_planes_fragment:`#if NUM_CLIPPING_PLANES > 0
	vec4 plane;
	#ifdef ALPHA_TO_COVERAGE
		float distanceToPlane, distanceGradient;
		float clipOpacity = 1.0;
		#pragma unroll_loop_start
		for ( int i = 0; i < UNION_CLIPPING_PLANES; i ++ ) {
			plane = clippingPlanes[ i ];
			distanceToPlane = - dot( vClipPosition, plane.xyz ) + plane.w;
			distanceGradient = fwidth( distanceToPlane ) / 2.0;
			clipOpacity *= smoothstep( - distanceGradient, distanceGradient, distanceToPlane );
			if ( clipOpacity == 0.0 ) discard;
		}
		#pragma unroll_loop_end
		#if UNION_CLIPPING_PLANES < NUM_CLIPPING_PLANES
			float unionClipOpacity = 1.0;
			#pragma unroll_loop_start
			for ( int i = UNION_CLIPPING_PLANES; i < NUM_CLIPPING_PLANES; i ++ ) {
				plane = clippingPlanes[ i ];
				distanceToPlane = - dot( vClipPosition, plane.xyz ) + plane.w;
				distanceGradient = fwidth( distanceToPlane ) / 2.0;
				unionClipOpacity *= 1.0 - smoothstep( - distanceGradient, distanceGradient, distanceToPlane );
			}
			#pragma unroll_loop_end
			clipOpacity *= 1.0 - unionClipOpacity;
		#endif
		diffuseColor.a *= clipOpacity;
		if ( diffuseColor.a == 0.0 ) discard;
	#else
		#pragma unroll_loop_start
		for ( int i = 0; i < UNION_CLIPPING_PLANES; i ++ ) {
			plane = clippingPlanes[ i ];
			if ( dot( vClipPosition, plane.xyz ) > plane.w ) discard;
		}
		#pragma unroll_loop_end
		#if UNION_CLIPPING_PLANES < NUM_CLIPPING_PLANES
			bool clipped = true;
			#pragma unroll_loop_start
			for ( int i = UNION_CLIPPING_PLANES; i < NUM_CLIPPING_PLANES; i ++ ) {
				plane = clippingPlanes[ i ];
				clipped = ( dot( vClipPosition, plane.xyz ) > plane.w ) && clipped;
			}
			#pragma unroll_loop_end
			if ( clipped ) discard;
		#endif
	#endif
#endif`,clipping_planes_pars_fragment:`#if NUM_CLIPPING_PLANES > 0
	varying vec3 vClipPosition;
	uniform vec4 clippingPlanes[ NUM_CLIPPING_PLANES ];
#endif`,clipping_planes_pars_vertex:`#if NUM_CLIPPING_PLANES > 0
	varying vec3 vClipPosition;
#endif`,clipping_planes_vertex:`#if NUM_CLIPPING_PLANES > 0
	vClipPosition = - mvPosition.xyz;
#endif`,color_fragment:`#if defined( USE_COLOR ) || defined( USE_COLOR_ALPHA )
	diffuseColor *= vColor;
#endif`,color_pars_fragment:`#if defined( USE_COLOR ) || defined( USE_COLOR_ALPHA )
	varying vec4 vColor;
#endif`,color_pars_vertex:`#if defined( USE_COLOR ) || defined( USE_COLOR_ALPHA ) || defined( USE_INSTANCING_COLOR ) || defined( USE_BATCHING_COLOR )
	varying vec4 vColor;
#endif`,color_vertex:`#if defined( USE_COLOR ) || defined( USE_COLOR_ALPHA ) || defined( USE_INSTANCING_COLOR ) || defined( USE_BATCHING_COLOR )
	vColor = vec4( 1.0 );
#endif
#ifdef USE_COLOR_ALPHA
	vColor *= color;
#elif defined( USE_COLOR )
	vColor.rgb *= color;
#endif
#ifdef USE_INSTANCING_COLOR
	vColor.rgb *= instanceColor.rgb;
#endif
#ifdef USE_BATCHING_COLOR
	vColor *= getBatchingColor( getIndirectIndex( gl_DrawID ) );
#endif`,common:`#define PI 3.141592653589793
#define PI2 6.283185307179586
#define PI_HALF 1.5707963267948966
#define RECIPROCAL_PI 0.3183098861837907
#define RECIPROCAL_PI2 0.15915494309189535
#define EPSILON 1e-6
#ifndef saturate
#define saturate( a ) clamp( a, 0.0, 1.0 )
#endif
#define whiteComplement( a ) ( 1.0 - saturate( a ) )
float pow2( const in float x ) { return x*x; }
vec3 pow2( const in vec3 x ) { return x*x; }
float pow3( const in float x ) { return x*x*x; }
float pow4( const in float x ) { float x2 = x*x; return x2*x2; }
float max3( const in vec3 v ) { return max( max( v.x, v.y ), v.z ); }
float average( const in vec3 v ) { return dot( v, vec3( 0.3333333 ) ); }
highp float rand( const in vec2 uv ) {
	const highp float a = 12.9898, b = 78.233, c = 43758.5453;
	highp float dt = dot( uv.xy, vec2( a,b ) ), sn = mod( dt, PI );
	return fract( sin( sn ) * c );
}
#ifdef HIGH_PRECISION
	float precisionSafeLength( vec3 v ) { return length( v ); }
#else
	float precisionSafeLength( vec3 v ) {
		float maxComponent = max3( abs( v ) );
		return length( v / maxComponent ) * maxComponent;
	}
#endif
struct IncidentLight {
	vec3 color;
	vec3 direction;
	bool visible;
};
struct ReflectedLight {
	vec3 directDiffuse;
	vec3 directSpecular;
	vec3 indirectDiffuse;
	vec3 indirectSpecular;
};
#ifdef USE_ALPHAHASH
	varying vec3 vPosition;
#endif
vec3 transformDirection( in vec3 dir, in mat4 matrix ) {
	return normalize( ( matrix * vec4( dir, 0.0 ) ).xyz );
}
#define inverseTransformDirection transformDirectionByInverseViewMatrix
vec3 transformNormalByInverseViewMatrix( in vec3 normal, in mat4 viewMatrix ) {
	return normalize( ( vec4( normal, 0.0 ) * viewMatrix ).xyz );
}
vec3 transformDirectionByInverseViewMatrix( in vec3 dir, in mat4 viewMatrix ) {
	return normalize( ( vec4( dir, 0.0 ) * viewMatrix ).xyz );
}
bool isPerspectiveMatrix( mat4 m ) {
	return m[ 2 ][ 3 ] == - 1.0;
}
vec2 equirectUv( in vec3 dir ) {
	float u = atan( dir.z, dir.x ) * RECIPROCAL_PI2 + 0.5;
	float v = asin( clamp( dir.y, - 1.0, 1.0 ) ) * RECIPROCAL_PI + 0.5;
	return vec2( u, v );
}
vec3 BRDF_Lambert( const in vec3 diffuseColor ) {
	return RECIPROCAL_PI * diffuseColor;
}
vec3 F_Schlick( const in vec3 f0, const in float f90, const in float dotVH ) {
	float fresnel = exp2( ( - 5.55473 * dotVH - 6.98316 ) * dotVH );
	return f0 * ( 1.0 - fresnel ) + ( f90 * fresnel );
}
float F_Schlick( const in float f0, const in float f90, const in float dotVH ) {
	float fresnel = exp2( ( - 5.55473 * dotVH - 6.98316 ) * dotVH );
	return f0 * ( 1.0 - fresnel ) + ( f90 * fresnel );
} // validated`,defaultnormal_vertex:`vec3 transformedNormal = objectNormal;
#ifdef USE_TANGENT
	vec3 transformedTangent = objectTangent;
#endif
#ifdef USE_BATCHING
	mat3 bm = mat3( batchingMatrix );
	transformedNormal /= vec3( dot( bm[ 0 ], bm[ 0 ] ), dot( bm[ 1 ], bm[ 1 ] ), dot( bm[ 2 ], bm[ 2 ] ) );
	transformedNormal = bm * transformedNormal;
	#ifdef USE_TANGENT
		transformedTangent = bm * transformedTangent;
	#endif
#endif
#ifdef USE_INSTANCING
	mat3 im = mat3( instanceMatrix );
	transformedNormal /= vec3( dot( im[ 0 ], im[ 0 ] ), dot( im[ 1 ], im[ 1 ] ), dot( im[ 2 ], im[ 2 ] ) );
	transformedNormal = im * transformedNormal;
	#ifdef USE_TANGENT
		transformedTangent = im * transformedTangent;
	#endif
#endif
transformedNormal = normalMatrix * transformedNormal;
#ifdef FLIP_SIDED
	transformedNormal = - transformedNormal;
#endif
#ifdef USE_TANGENT
	transformedTangent = ( modelViewMatrix * vec4( transformedTangent, 0.0 ) ).xyz;
#endif`,displacementmap_pars_vertex:`#ifdef USE_DISPLACEMENTMAP
	uniform sampler2D displacementMap;
	uniform float displacementScale;
	uniform float displacementBias;
#endif`,displacementmap_vertex:`#ifdef USE_DISPLACEMENTMAP
	transformed += normalize( objectNormal ) * ( texture2D( displacementMap, vDisplacementMapUv ).x * displacementScale + displacementBias );
#endif`,emissivemap_fragment:`#ifdef USE_EMISSIVEMAP
	vec4 emissiveColor = texture2D( emissiveMap, vEmissiveMapUv );
	#ifdef DECODE_VIDEO_TEXTURE_EMISSIVE
		emissiveColor = sRGBTransferEOTF( emissiveColor );
	#endif
	totalEmissiveRadiance *= emissiveColor.rgb;
#endif`,emissivemap_pars_fragment:`#ifdef USE_EMISSIVEMAP
	uniform sampler2D emissiveMap;
#endif`,colorspace_fragment:`gl_FragColor = linearToOutputTexel( gl_FragColor );`,colorspace_pars_fragment:`vec4 LinearTransferOETF( in vec4 value ) {
	return value;
}
vec4 sRGBTransferEOTF( in vec4 value ) {
	return vec4( mix( pow( value.rgb * 0.9478672986 + vec3( 0.0521327014 ), vec3( 2.4 ) ), value.rgb * 0.0773993808, vec3( lessThanEqual( value.rgb, vec3( 0.04045 ) ) ) ), value.a );
}
vec4 sRGBTransferOETF( in vec4 value ) {
	return vec4( mix( pow( value.rgb, vec3( 0.41666 ) ) * 1.055 - vec3( 0.055 ), value.rgb * 12.92, vec3( lessThanEqual( value.rgb, vec3( 0.0031308 ) ) ) ), value.a );
}`,envmap_fragment:`#ifdef USE_ENVMAP
	#ifdef ENV_WORLDPOS
		vec3 cameraToFrag;
		if ( isOrthographic ) {
			cameraToFrag = normalize( vec3( - viewMatrix[ 0 ][ 2 ], - viewMatrix[ 1 ][ 2 ], - viewMatrix[ 2 ][ 2 ] ) );
		} else {
			cameraToFrag = normalize( vWorldPosition - cameraPosition );
		}
		vec3 worldNormal = transformNormalByInverseViewMatrix( normal, viewMatrix );
		#ifdef ENVMAP_MODE_REFLECTION
			vec3 reflectVec = reflect( cameraToFrag, worldNormal );
		#else
			vec3 reflectVec = refract( cameraToFrag, worldNormal, refractionRatio );
		#endif
	#else
		vec3 reflectVec = vReflect;
	#endif
	#ifdef ENVMAP_TYPE_CUBE
		vec4 envColor = textureCube( envMap, envMapRotation * reflectVec );
		#ifdef ENVMAP_BLENDING_MULTIPLY
			outgoingLight = mix( outgoingLight, outgoingLight * envColor.xyz, specularStrength * reflectivity );
		#elif defined( ENVMAP_BLENDING_MIX )
			outgoingLight = mix( outgoingLight, envColor.xyz, specularStrength * reflectivity );
		#elif defined( ENVMAP_BLENDING_ADD )
			outgoingLight += envColor.xyz * specularStrength * reflectivity;
		#endif
	#endif
#endif`,envmap_common_pars_fragment:`#ifdef USE_ENVMAP
	uniform float envMapIntensity;
	uniform mat3 envMapRotation;
	uniform samplerCube envMap;
	#ifdef ENVMAP_TYPE_PMREM
		float roughnessToMip( const in float roughness ) {
			float r = clamp( roughness, 0.0, 1.0 );
			return ENVMAP_MAX_LOD * r * ( 2.0 - r );
		}
	#endif
#endif`,envmap_pars_fragment:`#ifdef USE_ENVMAP
	uniform float reflectivity;
	#if defined( USE_BUMPMAP ) || defined( USE_NORMALMAP ) || defined( PHONG ) || defined( LAMBERT )
		#define ENV_WORLDPOS
	#endif
	#ifdef ENV_WORLDPOS
		varying vec3 vWorldPosition;
		uniform float refractionRatio;
	#else
		varying vec3 vReflect;
	#endif
#endif`,envmap_pars_vertex:`#ifdef USE_ENVMAP
	#if defined( USE_BUMPMAP ) || defined( USE_NORMALMAP ) || defined( PHONG ) || defined( LAMBERT )
		#define ENV_WORLDPOS
	#endif
	#ifdef ENV_WORLDPOS
		
		varying vec3 vWorldPosition;
	#else
		varying vec3 vReflect;
		uniform float refractionRatio;
	#endif
#endif`,envmap_physical_pars_fragment:`#ifdef USE_ENVMAP
	vec3 getIBLIrradiance( const in vec3 normal ) {
		#ifdef ENVMAP_TYPE_PMREM
			vec3 worldNormal = transformNormalByInverseViewMatrix( normal, viewMatrix );
			vec4 envMapColor = textureLod( envMap, envMapRotation * worldNormal, ENVMAP_MAX_LOD );
			return PI * envMapColor.rgb * envMapIntensity;
		#else
			return vec3( 0.0 );
		#endif
	}
	vec3 getIBLRadiance( const in vec3 viewDir, const in vec3 normal, const in float roughness ) {
		#ifdef ENVMAP_TYPE_PMREM
			vec3 reflectVec = reflect( - viewDir, normal );
			reflectVec = normalize( mix( reflectVec, normal, pow4( roughness ) ) );
			reflectVec = transformDirectionByInverseViewMatrix( reflectVec, viewMatrix );
			vec4 envMapColor = textureLod( envMap, envMapRotation * reflectVec, roughnessToMip( roughness ) );
			return envMapColor.rgb * envMapIntensity;
		#else
			return vec3( 0.0 );
		#endif
	}
	#ifdef USE_RETROREFLECTION
		vec3 getIBLRetroRadiance( const in vec3 viewDir, const in vec3 normal, const in float roughness ) {
			#ifdef ENVMAP_TYPE_PMREM
				vec3 retroVec = normalize( mix( viewDir, normal, pow4( roughness ) ) );
				retroVec = transformDirectionByInverseViewMatrix( retroVec, viewMatrix );
				vec4 envMapColor = textureLod( envMap, envMapRotation * retroVec, roughnessToMip( roughness ) );
				return envMapColor.rgb * envMapIntensity;
			#else
				return vec3( 0.0 );
			#endif
		}
	#endif
	#ifdef USE_ANISOTROPY
		vec3 getIBLAnisotropyRadiance( const in vec3 viewDir, const in vec3 normal, const in float roughness, const in vec3 bitangent, const in float anisotropy ) {
			#ifdef ENVMAP_TYPE_PMREM
				vec3 bentNormal = cross( bitangent, viewDir );
				bentNormal = normalize( cross( bentNormal, bitangent ) );
				bentNormal = normalize( mix( bentNormal, normal, pow2( pow2( 1.0 - anisotropy * ( 1.0 - roughness ) ) ) ) );
				return getIBLRadiance( viewDir, bentNormal, roughness );
			#else
				return vec3( 0.0 );
			#endif
		}
		#ifdef USE_RETROREFLECTION
			vec3 getIBLAnisotropyRetroRadiance( const in vec3 viewDir, const in vec3 normal, const in float roughness, const in vec3 bitangent, const in float anisotropy ) {
				#ifdef ENVMAP_TYPE_PMREM
					vec3 bentNormal = cross( bitangent, viewDir );
					bentNormal = normalize( cross( bentNormal, bitangent ) );
					bentNormal = normalize( mix( bentNormal, normal, pow2( pow2( 1.0 - anisotropy * ( 1.0 - roughness ) ) ) ) );
					return getIBLRetroRadiance( viewDir, bentNormal, roughness );
				#else
					return vec3( 0.0 );
				#endif
			}
		#endif
	#endif
#endif`,envmap_vertex:`#ifdef USE_ENVMAP
	#ifdef ENV_WORLDPOS
		vWorldPosition = worldPosition.xyz;
	#else
		vec3 cameraToVertex;
		if ( isOrthographic ) {
			cameraToVertex = normalize( vec3( - viewMatrix[ 0 ][ 2 ], - viewMatrix[ 1 ][ 2 ], - viewMatrix[ 2 ][ 2 ] ) );
		} else {
			cameraToVertex = normalize( worldPosition.xyz - cameraPosition );
		}
		vec3 worldNormal = transformNormalByInverseViewMatrix( transformedNormal, viewMatrix );
		#ifdef ENVMAP_MODE_REFLECTION
			vReflect = reflect( cameraToVertex, worldNormal );
		#else
			vReflect = refract( cameraToVertex, worldNormal, refractionRatio );
		#endif
	#endif
#endif`,fog_vertex:`#ifdef USE_FOG
	vFogDepth = - mvPosition.z;
#endif`,fog_pars_vertex:`#ifdef USE_FOG
	varying float vFogDepth;
#endif`,fog_fragment:`#ifdef USE_FOG
	#ifdef FOG_EXP2
		float fogFactor = 1.0 - exp( - fogDensity * fogDensity * vFogDepth * vFogDepth );
	#else
		float fogFactor = smoothstep( fogNear, fogFar, vFogDepth );
	#endif
	gl_FragColor.rgb = mix( gl_FragColor.rgb, fogColor, fogFactor );
#endif`,fog_pars_fragment:`#ifdef USE_FOG
	uniform vec3 fogColor;
	varying float vFogDepth;
	#ifdef FOG_EXP2
		uniform float fogDensity;
	#else
		uniform float fogNear;
		uniform float fogFar;
	#endif
#endif`,gradientmap_pars_fragment:`#ifdef USE_GRADIENTMAP
	uniform sampler2D gradientMap;
#endif
vec3 getGradientIrradiance( vec3 normal, vec3 lightDirection ) {
	float dotNL = dot( normal, lightDirection );
	vec2 coord = vec2( dotNL * 0.5 + 0.5, 0.0 );
	#ifdef USE_GRADIENTMAP
		return vec3( texture2D( gradientMap, coord ).r );
	#else
		vec2 fw = fwidth( coord ) * 0.5;
		return mix( vec3( 0.7 ), vec3( 1.0 ), smoothstep( 0.7 - fw.x, 0.7 + fw.x, coord.x ) );
	#endif
}`,lightmap_pars_fragment:`#ifdef USE_LIGHTMAP
	uniform sampler2D lightMap;
	uniform float lightMapIntensity;
#endif`,lights_lambert_fragment:`LambertMaterial material;
material.diffuseColor = diffuseColor.rgb;
material.specularStrength = specularStrength;`,lights_lambert_pars_fragment:`varying vec3 vViewPosition;
struct LambertMaterial {
	vec3 diffuseColor;
	float specularStrength;
};
void RE_Direct_Lambert( const in IncidentLight directLight, const in vec3 geometryPosition, const in vec3 geometryNormal, const in vec3 geometryViewDir, const in vec3 geometryClearcoatNormal, const in LambertMaterial material, inout ReflectedLight reflectedLight ) {
	float dotNL = saturate( dot( geometryNormal, directLight.direction ) );
	vec3 irradiance = dotNL * directLight.color;
	reflectedLight.directDiffuse += irradiance * BRDF_Lambert( material.diffuseColor );
}
void RE_IndirectDiffuse_Lambert( const in vec3 irradiance, const in vec3 geometryPosition, const in vec3 geometryNormal, const in vec3 geometryViewDir, const in vec3 geometryClearcoatNormal, const in LambertMaterial material, inout ReflectedLight reflectedLight ) {
	reflectedLight.indirectDiffuse += irradiance * BRDF_Lambert( material.diffuseColor );
}
#define RE_Direct				RE_Direct_Lambert
#define RE_IndirectDiffuse		RE_IndirectDiffuse_Lambert`,lights_pars_begin:`uniform bool receiveShadow;
uniform vec3 ambientLightColor;
#if defined( USE_LIGHT_PROBES )
	uniform vec3 lightProbe[ 9 ];
#endif
vec3 shGetIrradianceAt( in vec3 normal, in vec3 shCoefficients[ 9 ] ) {
	float x = normal.x, y = normal.y, z = normal.z;
	vec3 result = shCoefficients[ 0 ] * 0.886227;
	result += shCoefficients[ 1 ] * 2.0 * 0.511664 * y;
	result += shCoefficients[ 2 ] * 2.0 * 0.511664 * z;
	result += shCoefficients[ 3 ] * 2.0 * 0.511664 * x;
	result += shCoefficients[ 4 ] * 2.0 * 0.429043 * x * y;
	result += shCoefficients[ 5 ] * 2.0 * 0.429043 * y * z;
	result += shCoefficients[ 6 ] * ( 0.743125 * z * z - 0.247708 );
	result += shCoefficients[ 7 ] * 2.0 * 0.429043 * x * z;
	result += shCoefficients[ 8 ] * 0.429043 * ( x * x - y * y );
	return result;
}
vec3 getLightProbeIrradiance( const in vec3 lightProbe[ 9 ], const in vec3 normal ) {
	vec3 worldNormal = transformNormalByInverseViewMatrix( normal, viewMatrix );
	vec3 irradiance = shGetIrradianceAt( worldNormal, lightProbe );
	return irradiance;
}
vec3 getAmbientLightIrradiance( const in vec3 ambientLightColor ) {
	vec3 irradiance = ambientLightColor;
	return irradiance;
}
float getDistanceAttenuation( const in float lightDistance, const in float cutoffDistance, const in float decayExponent ) {
	float distanceFalloff = 1.0 / max( pow( lightDistance, decayExponent ), 0.01 );
	if ( cutoffDistance > 0.0 ) {
		distanceFalloff *= pow2( saturate( 1.0 - pow4( lightDistance / cutoffDistance ) ) );
	}
	return distanceFalloff;
}
float getSpotAttenuation( const in float coneCosine, const in float penumbraCosine, const in float angleCosine ) {
	return smoothstep( coneCosine, penumbraCosine, angleCosine );
}
#if NUM_SUN_LIGHTS > 0
	struct SunLight {
		vec3 direction;
		vec3 color;
	};
	uniform SunLight sunLights[ NUM_SUN_LIGHTS ];
	void getSunLightInfo( const in SunLight sunLight, out IncidentLight light ) {
		light.color = sunLight.color;
		light.direction = sunLight.direction;
		light.visible = true;
	}
#endif
#if NUM_DIR_LIGHTS > 0
	struct DirectionalLight {
		vec3 direction;
		vec3 color;
	};
	uniform DirectionalLight directionalLights[ NUM_DIR_LIGHTS ];
	void getDirectionalLightInfo( const in DirectionalLight directionalLight, out IncidentLight light ) {
		light.color = directionalLight.color;
		light.direction = directionalLight.direction;
		light.visible = true;
	}
#endif
#if NUM_POINT_LIGHTS > 0
	struct PointLight {
		vec3 position;
		vec3 color;
		float distance;
		float decay;
	};
	uniform PointLight pointLights[ NUM_POINT_LIGHTS ];
	void getPointLightInfo( const in PointLight pointLight, const in vec3 geometryPosition, out IncidentLight light ) {
		vec3 lVector = pointLight.position - geometryPosition;
		light.direction = normalize( lVector );
		float lightDistance = length( lVector );
		light.color = pointLight.color;
		light.color *= getDistanceAttenuation( lightDistance, pointLight.distance, pointLight.decay );
		light.visible = ( light.color != vec3( 0.0 ) );
	}
#endif
#if NUM_SPOT_LIGHTS > 0
	struct SpotLight {
		vec3 position;
		vec3 direction;
		vec3 color;
		float distance;
		float decay;
		float coneCos;
		float penumbraCos;
	};
	uniform SpotLight spotLights[ NUM_SPOT_LIGHTS ];
	void getSpotLightInfo( const in SpotLight spotLight, const in vec3 geometryPosition, out IncidentLight light ) {
		vec3 lVector = spotLight.position - geometryPosition;
		light.direction = normalize( lVector );
		float angleCos = dot( light.direction, spotLight.direction );
		float spotAttenuation = getSpotAttenuation( spotLight.coneCos, spotLight.penumbraCos, angleCos );
		if ( spotAttenuation > 0.0 ) {
			float lightDistance = length( lVector );
			light.color = spotLight.color * spotAttenuation;
			light.color *= getDistanceAttenuation( lightDistance, spotLight.distance, spotLight.decay );
			light.visible = ( light.color != vec3( 0.0 ) );
		} else {
			light.color = vec3( 0.0 );
			light.visible = false;
		}
	}
#endif
#if NUM_RECT_AREA_LIGHTS > 0
	struct RectAreaLight {
		vec3 color;
		vec3 position;
		vec3 halfWidth;
		vec3 halfHeight;
	};
	uniform sampler2D ltc_1;	uniform sampler2D ltc_2;
	uniform RectAreaLight rectAreaLights[ NUM_RECT_AREA_LIGHTS ];
#endif
#if NUM_HEMI_LIGHTS > 0
	struct HemisphereLight {
		vec3 direction;
		vec3 skyColor;
		vec3 groundColor;
	};
	uniform HemisphereLight hemisphereLights[ NUM_HEMI_LIGHTS ];
	vec3 getHemisphereLightIrradiance( const in HemisphereLight hemiLight, const in vec3 normal ) {
		float dotNL = dot( normal, hemiLight.direction );
		float hemiDiffuseWeight = 0.5 * dotNL + 0.5;
		vec3 irradiance = mix( hemiLight.groundColor, hemiLight.skyColor, hemiDiffuseWeight );
		return irradiance;
	}
#endif
#include <lightprobes_pars_fragment>`,lights_toon_fragment:`ToonMaterial material;
material.diffuseColor = diffuseColor.rgb;`,lights_toon_pars_fragment:`varying vec3 vViewPosition;
struct ToonMaterial {
	vec3 diffuseColor;
};
void RE_Direct_Toon( const in IncidentLight directLight, const in vec3 geometryPosition, const in vec3 geometryNormal, const in vec3 geometryViewDir, const in vec3 geometryClearcoatNormal, const in ToonMaterial material, inout ReflectedLight reflectedLight ) {
	vec3 irradiance = getGradientIrradiance( geometryNormal, directLight.direction ) * directLight.color;
	reflectedLight.directDiffuse += irradiance * BRDF_Lambert( material.diffuseColor );
}
void RE_IndirectDiffuse_Toon( const in vec3 irradiance, const in vec3 geometryPosition, const in vec3 geometryNormal, const in vec3 geometryViewDir, const in vec3 geometryClearcoatNormal, const in ToonMaterial material, inout ReflectedLight reflectedLight ) {
	reflectedLight.indirectDiffuse += irradiance * BRDF_Lambert( material.diffuseColor );
}
#define RE_Direct				RE_Direct_Toon
#define RE_IndirectDiffuse		RE_IndirectDiffuse_Toon`,lights_phong_fragment:`BlinnPhongMaterial material;
material.diffuseColor = diffuseColor.rgb;
material.specularColor = specular;
material.specularShininess = shininess;
material.specularStrength = specularStrength;`,lights_phong_pars_fragment:`varying vec3 vViewPosition;
struct BlinnPhongMaterial {
	vec3 diffuseColor;
	vec3 specularColor;
	float specularShininess;
	float specularStrength;
};
void RE_Direct_BlinnPhong( const in IncidentLight directLight, const in vec3 geometryPosition, const in vec3 geometryNormal, const in vec3 geometryViewDir, const in vec3 geometryClearcoatNormal, const in BlinnPhongMaterial material, inout ReflectedLight reflectedLight ) {
	float dotNL = saturate( dot( geometryNormal, directLight.direction ) );
	vec3 irradiance = dotNL * directLight.color;
	reflectedLight.directDiffuse += irradiance * BRDF_Lambert( material.diffuseColor );
	reflectedLight.directSpecular += irradiance * BRDF_BlinnPhong( directLight.direction, geometryViewDir, geometryNormal, material.specularColor, material.specularShininess ) * material.specularStrength;
}
void RE_IndirectDiffuse_BlinnPhong( const in vec3 irradiance, const in vec3 geometryPosition, const in vec3 geometryNormal, const in vec3 geometryViewDir, const in vec3 geometryClearcoatNormal, const in BlinnPhongMaterial material, inout ReflectedLight reflectedLight ) {
	reflectedLight.indirectDiffuse += irradiance * BRDF_Lambert( material.diffuseColor );
}
#define RE_Direct				RE_Direct_BlinnPhong
#define RE_IndirectDiffuse		RE_IndirectDiffuse_BlinnPhong`,lights_physical_fragment:`PhysicalMaterial material;
material.diffuseColor = diffuseColor.rgb;
material.diffuseContribution = diffuseColor.rgb * ( 1.0 - metalnessFactor );
material.metalness = metalnessFactor;
vec3 dxy = max( abs( dFdx( nonPerturbedNormal ) ), abs( dFdy( nonPerturbedNormal ) ) );
float geometryRoughness = max( max( dxy.x, dxy.y ), dxy.z );
material.roughness = max( roughnessFactor, 0.045 );
material.roughness += geometryRoughness;
material.roughness = min( material.roughness, 1.0 );
#ifdef USE_DIFFUSE_ROUGHNESS
	float diffuseRoughnessFactor = diffuseRoughness;
	#ifdef USE_DIFFUSE_ROUGHNESSMAP
		diffuseRoughnessFactor *= texture2D( diffuseRoughnessMap, vDiffuseRoughnessMapUv ).r;
	#endif
	material.diffuseRoughness = saturate( diffuseRoughnessFactor );
#endif
#ifdef IOR
	material.ior = ior;
	#ifdef USE_SPECULAR
		float specularIntensityFactor = specularIntensity;
		vec3 specularColorFactor = specularColor;
		#ifdef USE_SPECULAR_COLORMAP
			specularColorFactor *= texture2D( specularColorMap, vSpecularColorMapUv ).rgb;
		#endif
		#ifdef USE_SPECULAR_INTENSITYMAP
			specularIntensityFactor *= texture2D( specularIntensityMap, vSpecularIntensityMapUv ).a;
		#endif
		material.specularF90 = mix( specularIntensityFactor, 1.0, metalnessFactor );
	#else
		float specularIntensityFactor = 1.0;
		vec3 specularColorFactor = vec3( 1.0 );
		material.specularF90 = 1.0;
	#endif
	material.specularColor = min( pow2( ( material.ior - 1.0 ) / ( material.ior + 1.0 ) ) * specularColorFactor, vec3( 1.0 ) ) * specularIntensityFactor;
	material.specularColorBlended = mix( material.specularColor, diffuseColor.rgb, metalnessFactor );
#else
	material.specularColor = vec3( 0.04 );
	material.specularColorBlended = mix( material.specularColor, diffuseColor.rgb, metalnessFactor );
	material.specularF90 = 1.0;
#endif
#ifdef USE_CLEARCOAT
	material.clearcoat = clearcoat;
	material.clearcoatRoughness = clearcoatRoughness;
	material.clearcoatF0 = vec3( 0.04 );
	material.clearcoatF90 = 1.0;
	#ifdef USE_CLEARCOATMAP
		material.clearcoat *= texture2D( clearcoatMap, vClearcoatMapUv ).x;
	#endif
	#ifdef USE_CLEARCOAT_ROUGHNESSMAP
		material.clearcoatRoughness *= texture2D( clearcoatRoughnessMap, vClearcoatRoughnessMapUv ).y;
	#endif
	material.clearcoat = saturate( material.clearcoat );	material.clearcoatRoughness = max( material.clearcoatRoughness, 0.045 );
	material.clearcoatRoughness += geometryRoughness;
	material.clearcoatRoughness = min( material.clearcoatRoughness, 1.0 );
#endif
#ifdef USE_DISPERSION
	material.dispersion = dispersion;
#endif
#ifdef USE_RETROREFLECTION
	material.retroreflectivity = retroreflectivity;
#endif
#ifdef USE_IRIDESCENCE
	material.iridescence = iridescence;
	material.iridescenceIOR = iridescenceIOR;
	#ifdef USE_IRIDESCENCEMAP
		material.iridescence *= texture2D( iridescenceMap, vIridescenceMapUv ).r;
	#endif
	#ifdef USE_IRIDESCENCE_THICKNESSMAP
		material.iridescenceThickness = (iridescenceThicknessMaximum - iridescenceThicknessMinimum) * texture2D( iridescenceThicknessMap, vIridescenceThicknessMapUv ).g + iridescenceThicknessMinimum;
	#else
		material.iridescenceThickness = iridescenceThicknessMaximum;
	#endif
#endif
#ifdef USE_SHEEN
	material.sheenColor = sheenColor;
	#ifdef USE_SHEEN_COLORMAP
		material.sheenColor *= texture2D( sheenColorMap, vSheenColorMapUv ).rgb;
	#endif
	material.sheenRoughness = clamp( sheenRoughness, 0.0001, 1.0 );
	#ifdef USE_SHEEN_ROUGHNESSMAP
		material.sheenRoughness *= texture2D( sheenRoughnessMap, vSheenRoughnessMapUv ).a;
	#endif
#endif
#ifdef USE_ANISOTROPY
	#ifdef USE_ANISOTROPYMAP
		mat2 anisotropyMat = mat2( anisotropyVector.x, anisotropyVector.y, - anisotropyVector.y, anisotropyVector.x );
		vec3 anisotropyPolar = texture2D( anisotropyMap, vAnisotropyMapUv ).rgb;
		vec2 anisotropyV = anisotropyMat * normalize( 2.0 * anisotropyPolar.rg - vec2( 1.0 ) ) * anisotropyPolar.b;
	#else
		vec2 anisotropyV = anisotropyVector;
	#endif
	material.anisotropy = length( anisotropyV );
	if( material.anisotropy == 0.0 ) {
		anisotropyV = vec2( 1.0, 0.0 );
	} else {
		anisotropyV /= material.anisotropy;
		material.anisotropy = saturate( material.anisotropy );
	}
	material.alphaT = mix( pow2( material.roughness ), 1.0, pow2( material.anisotropy ) );
	material.anisotropyT = tbn[ 0 ] * anisotropyV.x + tbn[ 1 ] * anisotropyV.y;
	material.anisotropyB = tbn[ 1 ] * anisotropyV.x - tbn[ 0 ] * anisotropyV.y;
#endif`,lights_physical_pars_fragment:`uniform sampler2D dfgLUT;
struct PhysicalMaterial {
	vec3 diffuseColor;
	vec3 diffuseContribution;
	vec3 specularColor;
	vec3 specularColorBlended;
	float roughness;
	float metalness;
	float specularF90;
	float dispersion;
	vec2 dfg;
	vec3 multiScatteringCompensation;
	#ifdef USE_DIFFUSE_ROUGHNESS
		float diffuseRoughness;
	#endif
	#ifdef USE_RETROREFLECTION
		float retroreflectivity;
	#endif
	#ifdef USE_CLEARCOAT
		float clearcoat;
		float clearcoatRoughness;
		vec3 clearcoatF0;
		float clearcoatF90;
	#endif
	#ifdef USE_IRIDESCENCE
		float iridescence;
		float iridescenceIOR;
		float iridescenceThickness;
		vec3 iridescenceFresnel;
		vec3 iridescenceF0Dielectric;
		vec3 iridescenceF0Metallic;
	#endif
	#ifdef USE_SHEEN
		vec3 sheenColor;
		float sheenRoughness;
	#endif
	#ifdef IOR
		float ior;
	#endif
	#ifdef USE_TRANSMISSION
		float transmission;
		float transmissionAlpha;
		float thickness;
		float attenuationDistance;
		vec3 attenuationColor;
	#endif
	#ifdef USE_ANISOTROPY
		float anisotropy;
		float alphaT;
		vec3 anisotropyT;
		vec3 anisotropyB;
	#endif
};
vec3 clearcoatSpecularDirect = vec3( 0.0 );
vec3 clearcoatSpecularIndirect = vec3( 0.0 );
vec3 sheenSpecularDirect = vec3( 0.0 );
vec3 sheenSpecularIndirect = vec3(0.0 );
vec3 Schlick_to_F0( const in vec3 f, const in float f90, const in float dotVH ) {
    float x = clamp( 1.0 - dotVH, 0.0, 1.0 );
    float x2 = x * x;
    float x5 = clamp( x * x2 * x2, 0.0, 0.9999 );
    return ( f - vec3( f90 ) * x5 ) / ( 1.0 - x5 );
}
#ifdef USE_DIFFUSE_ROUGHNESS
	const float EON_EPSILON = 1e-7;
	float FON_DirectionalAlbedo( const in float mu, const in float roughness, const in float A ) {
		float muComp = 1.0 - mu;
		float gOverPi = muComp * ( 0.0571085289 + muComp * ( 0.491881867 + muComp * ( - 0.332181442 + muComp * 0.0714429953 ) ) );
		return A * ( 1.0 + roughness * gOverPi );
	}
	vec3 BRDF_EON( const in vec3 lightDir, const in vec3 viewDir, const in vec3 normal, const in vec3 diffuseColor, const in float roughness ) {
		vec3 rho = saturate( diffuseColor );
		if ( roughness <= EON_EPSILON ) return BRDF_Lambert( rho );
		float dotNL = saturate( dot( normal, lightDir ) );
		float dotNV = saturate( dot( normal, viewDir ) );
		float s = dot( lightDir, viewDir ) - dotNL * dotNV;
		float sOverT = ( s > 0.0 ) ? s / max( max( dotNL, dotNV ), EON_EPSILON ) : s;
		float A = 1.0 / ( 1.0 + ( 0.5 - 2.0 / ( 3.0 * PI ) ) * roughness );
		vec3 singleScatter = rho * RECIPROCAL_PI * A * ( 1.0 + roughness * sOverT );
		float averageAlbedo = A * ( 1.0 + ( 2.0 / 3.0 - 28.0 / ( 15.0 * PI ) ) * roughness );
		float albedoV = FON_DirectionalAlbedo( dotNV, roughness, A );
		float albedoL = FON_DirectionalAlbedo( dotNL, roughness, A );
		vec3 rhoMultiScatter = rho * rho * averageAlbedo / max( vec3( EON_EPSILON ), vec3( 1.0 ) - rho * ( 1.0 - averageAlbedo ) );
		vec3 multiScatter = rhoMultiScatter * RECIPROCAL_PI
			* max( EON_EPSILON, 1.0 - albedoV )
			* max( EON_EPSILON, 1.0 - albedoL )
			/ max( EON_EPSILON, 1.0 - averageAlbedo );
		return singleScatter + multiScatter;
	}
	vec3 EON_DirectionalAlbedo( const in vec3 diffuseColor, const in float roughness, const in float dotNV ) {
		vec3 rho = saturate( diffuseColor );
		if ( roughness <= EON_EPSILON ) return rho;
		float A = 1.0 / ( 1.0 + ( 0.5 - 2.0 / ( 3.0 * PI ) ) * roughness );
		float directionalAlbedo = FON_DirectionalAlbedo( dotNV, roughness, A );
		float averageAlbedo = A * ( 1.0 + ( 2.0 / 3.0 - 28.0 / ( 15.0 * PI ) ) * roughness );
		vec3 rhoMultiScatter = rho * rho * averageAlbedo / max( vec3( EON_EPSILON ), vec3( 1.0 ) - rho * ( 1.0 - averageAlbedo ) );
		return rho * directionalAlbedo + rhoMultiScatter * ( 1.0 - directionalAlbedo );
	}
#endif
float V_GGX_SmithCorrelated( const in float alpha, const in float dotNL, const in float dotNV ) {
	float a2 = pow2( alpha );
	float gv = dotNL * sqrt( a2 + ( 1.0 - a2 ) * pow2( dotNV ) );
	float gl = dotNV * sqrt( a2 + ( 1.0 - a2 ) * pow2( dotNL ) );
	return 0.5 / max( gv + gl, EPSILON );
}
float D_GGX( const in float alpha, const in float dotNH ) {
	float a2 = pow2( alpha );
	float denom = pow2( dotNH ) * ( a2 - 1.0 ) + 1.0;
	return RECIPROCAL_PI * a2 / pow2( denom );
}
#ifdef USE_ANISOTROPY
	float V_GGX_SmithCorrelated_Anisotropic( const in float alphaT, const in float alphaB, const in float dotTV, const in float dotBV, const in float dotTL, const in float dotBL, const in float dotNV, const in float dotNL ) {
		float gv = dotNL * length( vec3( alphaT * dotTV, alphaB * dotBV, dotNV ) );
		float gl = dotNV * length( vec3( alphaT * dotTL, alphaB * dotBL, dotNL ) );
		return 0.5 / max( gv + gl, EPSILON );
	}
	float D_GGX_Anisotropic( const in float alphaT, const in float alphaB, const in float dotNH, const in float dotTH, const in float dotBH ) {
		float a2 = alphaT * alphaB;
		highp vec3 v = vec3( alphaB * dotTH, alphaT * dotBH, a2 * dotNH );
		highp float v2 = dot( v, v );
		float w2 = a2 / v2;
		return RECIPROCAL_PI * a2 * pow2 ( w2 );
	}
#endif
#ifdef USE_CLEARCOAT
	vec3 BRDF_GGX_Clearcoat( const in vec3 lightDir, const in vec3 viewDir, const in vec3 normal, const in PhysicalMaterial material) {
		vec3 f0 = material.clearcoatF0;
		float f90 = material.clearcoatF90;
		float roughness = max( material.clearcoatRoughness, 0.045 );
		float alpha = pow2( roughness );
		vec3 halfDir = normalize( lightDir + viewDir );
		float dotNL = saturate( dot( normal, lightDir ) );
		float dotNV = saturate( dot( normal, viewDir ) );
		float dotNH = saturate( dot( normal, halfDir ) );
		float dotVH = saturate( dot( viewDir, halfDir ) );
		vec3 F = F_Schlick( f0, f90, dotVH );
		float V = V_GGX_SmithCorrelated( alpha, dotNL, dotNV );
		float D = D_GGX( alpha, dotNH );
		return F * ( V * D );
	}
#endif
vec3 BRDF_GGX( const in vec3 lightDir, const in vec3 viewDir, const in vec3 normal, const in PhysicalMaterial material ) {
	vec3 f0 = material.specularColorBlended;
	float f90 = material.specularF90;
	float roughness = max( material.roughness, 0.045 );
	float alpha = pow2( roughness );
	vec3 halfDir = normalize( lightDir + viewDir );
	float dotNL = saturate( dot( normal, lightDir ) );
	float dotNV = saturate( dot( normal, viewDir ) );
	float dotNH = saturate( dot( normal, halfDir ) );
	float dotVH = saturate( dot( viewDir, halfDir ) );
	vec3 F = F_Schlick( f0, f90, dotVH );
	#ifdef USE_IRIDESCENCE
		F = mix( F, material.iridescenceFresnel, material.iridescence );
	#endif
	#ifdef USE_ANISOTROPY
		float dotTL = dot( material.anisotropyT, lightDir );
		float dotTV = dot( material.anisotropyT, viewDir );
		float dotTH = dot( material.anisotropyT, halfDir );
		float dotBL = dot( material.anisotropyB, lightDir );
		float dotBV = dot( material.anisotropyB, viewDir );
		float dotBH = dot( material.anisotropyB, halfDir );
		float alphaT = max( material.alphaT, alpha );
		float V = V_GGX_SmithCorrelated_Anisotropic( alphaT, alpha, dotTV, dotBV, dotTL, dotBL, dotNV, dotNL );
		float D = D_GGX_Anisotropic( alphaT, alpha, dotNH, dotTH, dotBH );
	#else
		float V = V_GGX_SmithCorrelated( alpha, dotNL, dotNV );
		float D = D_GGX( alpha, dotNH );
	#endif
	return F * ( V * D );
}
vec2 LTC_Uv( const in vec3 N, const in vec3 V, const in float roughness ) {
	const float LUT_SIZE = 64.0;
	const float LUT_SCALE = ( LUT_SIZE - 1.0 ) / LUT_SIZE;
	const float LUT_BIAS = 0.5 / LUT_SIZE;
	float dotNV = saturate( dot( N, V ) );
	vec2 uv = vec2( roughness, sqrt( 1.0 - dotNV ) );
	uv = uv * LUT_SCALE + LUT_BIAS;
	return uv;
}
float LTC_ClippedSphereFormFactor( const in vec3 f ) {
	float l = length( f );
	return max( ( l * l + f.z ) / ( l + 1.0 ), 0.0 );
}
vec3 LTC_EdgeVectorFormFactor( const in vec3 v1, const in vec3 v2 ) {
	float x = dot( v1, v2 );
	float y = abs( x );
	float a = 0.8543985 + ( 0.4965155 + 0.0145206 * y ) * y;
	float b = 3.4175940 + ( 4.1616724 + y ) * y;
	float v = a / b;
	float theta_sintheta = ( x > 0.0 ) ? v : 0.5 * inversesqrt( max( 1.0 - x * x, 1e-7 ) ) - v;
	return cross( v1, v2 ) * theta_sintheta;
}
vec3 LTC_Evaluate( const in vec3 N, const in vec3 V, const in vec3 P, const in mat3 mInv, const in vec3 rectCoords[ 4 ] ) {
	vec3 v1 = rectCoords[ 1 ] - rectCoords[ 0 ];
	vec3 v2 = rectCoords[ 3 ] - rectCoords[ 0 ];
	vec3 lightNormal = cross( v1, v2 );
	if( dot( lightNormal, P - rectCoords[ 0 ] ) < 0.0 ) return vec3( 0.0 );
	vec3 T1, T2;
	T1 = normalize( V - N * dot( V, N ) );
	T2 = - cross( N, T1 );
	mat3 mat = mInv * transpose( mat3( T1, T2, N ) );
	vec3 coords[ 4 ];
	coords[ 0 ] = mat * ( rectCoords[ 0 ] - P );
	coords[ 1 ] = mat * ( rectCoords[ 1 ] - P );
	coords[ 2 ] = mat * ( rectCoords[ 2 ] - P );
	coords[ 3 ] = mat * ( rectCoords[ 3 ] - P );
	coords[ 0 ] = normalize( coords[ 0 ] );
	coords[ 1 ] = normalize( coords[ 1 ] );
	coords[ 2 ] = normalize( coords[ 2 ] );
	coords[ 3 ] = normalize( coords[ 3 ] );
	vec3 vectorFormFactor = vec3( 0.0 );
	vectorFormFactor += LTC_EdgeVectorFormFactor( coords[ 0 ], coords[ 1 ] );
	vectorFormFactor += LTC_EdgeVectorFormFactor( coords[ 1 ], coords[ 2 ] );
	vectorFormFactor += LTC_EdgeVectorFormFactor( coords[ 2 ], coords[ 3 ] );
	vectorFormFactor += LTC_EdgeVectorFormFactor( coords[ 3 ], coords[ 0 ] );
	float result = LTC_ClippedSphereFormFactor( vectorFormFactor );
	return vec3( result );
}
#if defined( USE_SHEEN )
float D_Charlie( float roughness, float dotNH ) {
	float alpha = pow2( roughness );
	float invAlpha = 1.0 / alpha;
	float cos2h = dotNH * dotNH;
	float sin2h = max( 1.0 - cos2h, 0.0078125 );
	return ( 2.0 + invAlpha ) * pow( sin2h, invAlpha * 0.5 ) / ( 2.0 * PI );
}
float V_Neubelt( float dotNV, float dotNL ) {
	return saturate( 1.0 / ( 4.0 * ( dotNL + dotNV - dotNL * dotNV ) ) );
}
vec3 BRDF_Sheen( const in vec3 lightDir, const in vec3 viewDir, const in vec3 normal, vec3 sheenColor, const in float sheenRoughness ) {
	vec3 halfDir = normalize( lightDir + viewDir );
	float dotNL = saturate( dot( normal, lightDir ) );
	float dotNV = saturate( dot( normal, viewDir ) );
	float dotNH = saturate( dot( normal, halfDir ) );
	float D = D_Charlie( sheenRoughness, dotNH );
	float V = V_Neubelt( dotNV, dotNL );
	return sheenColor * ( D * V );
}
#endif
float IBLSheenBRDF( const in vec3 normal, const in vec3 viewDir, const in float roughness ) {
	float dotNV = saturate( dot( normal, viewDir ) );
	float r2 = roughness * roughness;
	float rInv = 1.0 / ( roughness + 0.1 );
	float a = -1.9362 + 1.0678 * roughness + 0.4573 * r2 - 0.8469 * rInv;
	float b = -0.6014 + 0.5538 * roughness - 0.4670 * r2 - 0.1255 * rInv;
	float DG = exp( a * dotNV + b );
	return saturate( DG );
}
vec3 EnvironmentBRDF( const in vec3 normal, const in vec3 viewDir, const in vec3 specularColor, const in float specularF90, const in float roughness ) {
	float dotNV = saturate( dot( normal, viewDir ) );
	vec2 fab = texture2D( dfgLUT, vec2( roughness, dotNV ) ).rg;
	return specularColor * fab.x + specularF90 * fab.y;
}
#ifdef USE_IRIDESCENCE
void computeMultiscatteringIridescence( const in vec2 fab, const in vec3 specularColor, const in float specularF90, const in float iridescence, const in vec3 iridescenceF0, inout vec3 singleScatter, inout vec3 multiScatter ) {
#else
void computeMultiscattering( const in vec2 fab, const in vec3 specularColor, const in float specularF90, inout vec3 singleScatter, inout vec3 multiScatter ) {
#endif
	#ifdef USE_IRIDESCENCE
		vec3 Fr = mix( specularColor, iridescenceF0, iridescence );
	#else
		vec3 Fr = specularColor;
	#endif
	vec3 FssEss = Fr * fab.x + specularF90 * fab.y;
	float Ess = fab.x + fab.y;
	float Ems = 1.0 - Ess;
	vec3 Favg = Fr + ( 1.0 - Fr ) * 0.047619;	vec3 Fms = FssEss * Favg / ( 1.0 - Ems * Favg );
	singleScatter += FssEss;
	multiScatter += Fms * Ems;
}
#if NUM_RECT_AREA_LIGHTS > 0
	void RE_Direct_RectArea_Physical( const in RectAreaLight rectAreaLight, const in vec3 geometryPosition, const in vec3 geometryNormal, const in vec3 geometryViewDir, const in vec3 geometryClearcoatNormal, const in PhysicalMaterial material, inout ReflectedLight reflectedLight ) {
		vec3 normal = geometryNormal;
		vec3 viewDir = geometryViewDir;
		vec3 position = geometryPosition;
		vec3 lightPos = rectAreaLight.position;
		vec3 halfWidth = rectAreaLight.halfWidth;
		vec3 halfHeight = rectAreaLight.halfHeight;
		vec3 lightColor = rectAreaLight.color;
		float roughness = material.roughness;
		vec3 rectCoords[ 4 ];
		rectCoords[ 0 ] = lightPos + halfWidth - halfHeight;		rectCoords[ 1 ] = lightPos - halfWidth - halfHeight;
		rectCoords[ 2 ] = lightPos - halfWidth + halfHeight;
		rectCoords[ 3 ] = lightPos + halfWidth + halfHeight;
		vec2 uv = LTC_Uv( normal, viewDir, roughness );
		vec4 t1 = texture2D( ltc_1, uv );
		vec4 t2 = texture2D( ltc_2, uv );
		mat3 mInv = mat3(
			vec3( t1.x, 0, t1.y ),
			vec3(    0, 1,    0 ),
			vec3( t1.z, 0, t1.w )
		);
		vec3 fresnel = ( material.specularColorBlended * t2.x + ( material.specularF90 - material.specularColorBlended ) * t2.y );
		reflectedLight.directSpecular += lightColor * fresnel * LTC_Evaluate( normal, viewDir, position, mInv, rectCoords );
		reflectedLight.directDiffuse += lightColor * material.diffuseContribution * LTC_Evaluate( normal, viewDir, position, mat3( 1.0 ), rectCoords );
		#ifdef USE_CLEARCOAT
			vec3 Ncc = geometryClearcoatNormal;
			vec2 uvClearcoat = LTC_Uv( Ncc, viewDir, material.clearcoatRoughness );
			vec4 t1Clearcoat = texture2D( ltc_1, uvClearcoat );
			vec4 t2Clearcoat = texture2D( ltc_2, uvClearcoat );
			mat3 mInvClearcoat = mat3(
				vec3( t1Clearcoat.x, 0, t1Clearcoat.y ),
				vec3(             0, 1,             0 ),
				vec3( t1Clearcoat.z, 0, t1Clearcoat.w )
			);
			vec3 fresnelClearcoat = material.clearcoatF0 * t2Clearcoat.x + ( material.clearcoatF90 - material.clearcoatF0 ) * t2Clearcoat.y;
			clearcoatSpecularDirect += lightColor * fresnelClearcoat * LTC_Evaluate( Ncc, viewDir, position, mInvClearcoat, rectCoords );
		#endif
	}
#endif
void RE_Direct_Physical( const in IncidentLight directLight, const in vec3 geometryPosition, const in vec3 geometryNormal, const in vec3 geometryViewDir, const in vec3 geometryClearcoatNormal, const in PhysicalMaterial material, inout ReflectedLight reflectedLight ) {
	float dotNL = saturate( dot( geometryNormal, directLight.direction ) );
	vec3 irradiance = dotNL * directLight.color;
	#ifdef USE_CLEARCOAT
		float dotNLcc = saturate( dot( geometryClearcoatNormal, directLight.direction ) );
		vec3 ccIrradiance = dotNLcc * directLight.color;
		clearcoatSpecularDirect += ccIrradiance * BRDF_GGX_Clearcoat( directLight.direction, geometryViewDir, geometryClearcoatNormal, material );
	#endif
	#ifdef USE_SHEEN
 
 		sheenSpecularDirect += irradiance * BRDF_Sheen( directLight.direction, geometryViewDir, geometryNormal, material.sheenColor, material.sheenRoughness );
 
 		float sheenAlbedoV = IBLSheenBRDF( geometryNormal, geometryViewDir, material.sheenRoughness );
 		float sheenAlbedoL = IBLSheenBRDF( geometryNormal, directLight.direction, material.sheenRoughness );
 
 		float sheenEnergyComp = 1.0 - max3( material.sheenColor ) * max( sheenAlbedoV, sheenAlbedoL );
 
 		irradiance *= sheenEnergyComp;
 
 	#endif
	vec3 specularBRDF = BRDF_GGX( directLight.direction, geometryViewDir, geometryNormal, material );
	#ifdef USE_RETROREFLECTION
		vec3 retroViewDir = reflect( - geometryViewDir, geometryNormal );
		vec3 retroSpecularBRDF = BRDF_GGX( directLight.direction, retroViewDir, geometryNormal, material );
		specularBRDF = mix( specularBRDF, retroSpecularBRDF, saturate( material.retroreflectivity ) );
	#endif
	reflectedLight.directSpecular += irradiance * specularBRDF * material.multiScatteringCompensation;
	vec3 halfDir = normalize( directLight.direction + geometryViewDir );
	float dotVH = saturate( dot( geometryViewDir, halfDir ) );
	vec3 F = F_Schlick( material.specularColor, material.specularF90, dotVH );
	#ifdef USE_RETROREFLECTION
		vec3 retroHalfDir = normalize( directLight.direction + retroViewDir );
		float dotRetroVH = saturate( dot( retroViewDir, retroHalfDir ) );
		vec3 retroF = F_Schlick( material.specularColor, material.specularF90, dotRetroVH );
		F = mix( F, retroF, saturate( material.retroreflectivity ) );
	#endif
	#ifdef USE_DIFFUSE_ROUGHNESS
		vec3 diffuseBRDF = BRDF_EON( directLight.direction, geometryViewDir, geometryNormal, material.diffuseColor, material.diffuseRoughness ) * ( 1.0 - material.metalness );
	#else
		vec3 diffuseBRDF = BRDF_Lambert( material.diffuseContribution );
	#endif
	reflectedLight.directDiffuse += irradiance * diffuseBRDF * ( 1.0 - F );
}
void RE_IndirectDiffuse_Physical( const in vec3 irradiance, const in vec3 geometryPosition, const in vec3 geometryNormal, const in vec3 geometryViewDir, const in vec3 geometryClearcoatNormal, const in PhysicalMaterial material, inout ReflectedLight reflectedLight ) {
	vec3 singleScattering = vec3( 0.0 );
	vec3 multiScattering = vec3( 0.0 );
	#ifdef USE_IRIDESCENCE
		computeMultiscatteringIridescence( material.dfg, material.specularColor, material.specularF90, material.iridescence, material.iridescenceF0Dielectric, singleScattering, multiScattering );
	#else
		computeMultiscattering( material.dfg, material.specularColor, material.specularF90, singleScattering, multiScattering );
	#endif
	#ifdef USE_DIFFUSE_ROUGHNESS
		float dotNV = saturate( dot( geometryNormal, geometryViewDir ) );
		vec3 diffuseAlbedo = EON_DirectionalAlbedo( material.diffuseColor, material.diffuseRoughness, dotNV ) * ( 1.0 - material.metalness );
		vec3 diffuse = irradiance * RECIPROCAL_PI * diffuseAlbedo * ( 1.0 - singleScattering - multiScattering );
	#else
		vec3 diffuse = irradiance * BRDF_Lambert( material.diffuseContribution ) * ( 1.0 - singleScattering - multiScattering );
	#endif
	#ifdef USE_SHEEN
		float sheenAlbedo = IBLSheenBRDF( geometryNormal, geometryViewDir, material.sheenRoughness );
		sheenSpecularIndirect += irradiance * material.sheenColor * sheenAlbedo * RECIPROCAL_PI;
		float sheenEnergyComp = 1.0 - max3( material.sheenColor ) * sheenAlbedo;
		diffuse *= sheenEnergyComp;
	#endif
	reflectedLight.indirectDiffuse += diffuse;
}
void RE_IndirectSpecular_Physical( const in vec3 radiance, const in vec3 irradiance, const in vec3 clearcoatRadiance, const in vec3 geometryPosition, const in vec3 geometryNormal, const in vec3 geometryViewDir, const in vec3 geometryClearcoatNormal, const in PhysicalMaterial material, inout ReflectedLight reflectedLight) {
	#ifdef USE_CLEARCOAT
		clearcoatSpecularIndirect += clearcoatRadiance * EnvironmentBRDF( geometryClearcoatNormal, geometryViewDir, material.clearcoatF0, material.clearcoatF90, material.clearcoatRoughness );
	#endif
	#ifdef USE_SHEEN
		sheenSpecularIndirect += irradiance * material.sheenColor * IBLSheenBRDF( geometryNormal, geometryViewDir, material.sheenRoughness ) * RECIPROCAL_PI;
 	#endif
	vec3 singleScatteringDielectric = vec3( 0.0 );
	vec3 multiScatteringDielectric = vec3( 0.0 );
	vec3 singleScatteringMetallic = vec3( 0.0 );
	vec3 multiScatteringMetallic = vec3( 0.0 );
	#ifdef USE_IRIDESCENCE
		computeMultiscatteringIridescence( material.dfg, material.specularColor, material.specularF90, material.iridescence, material.iridescenceF0Dielectric, singleScatteringDielectric, multiScatteringDielectric );
		computeMultiscatteringIridescence( material.dfg, material.diffuseColor, material.specularF90, material.iridescence, material.iridescenceF0Metallic, singleScatteringMetallic, multiScatteringMetallic );
	#else
		computeMultiscattering( material.dfg, material.specularColor, material.specularF90, singleScatteringDielectric, multiScatteringDielectric );
		computeMultiscattering( material.dfg, material.diffuseColor, material.specularF90, singleScatteringMetallic, multiScatteringMetallic );
	#endif
	vec3 singleScattering = mix( singleScatteringDielectric, singleScatteringMetallic, material.metalness );
	vec3 multiScattering = mix( multiScatteringDielectric, multiScatteringMetallic, material.metalness );
	vec3 totalScatteringDielectric = singleScatteringDielectric + multiScatteringDielectric;
	#ifdef USE_DIFFUSE_ROUGHNESS
		float dotNV = saturate( dot( geometryNormal, geometryViewDir ) );
		vec3 diffuse = EON_DirectionalAlbedo( material.diffuseColor, material.diffuseRoughness, dotNV ) * ( 1.0 - material.metalness ) * ( 1.0 - totalScatteringDielectric );
	#else
		vec3 diffuse = material.diffuseContribution * ( 1.0 - totalScatteringDielectric );
	#endif
	vec3 cosineWeightedIrradiance = irradiance * RECIPROCAL_PI;
	vec3 indirectSpecular = radiance * singleScattering;
	indirectSpecular += multiScattering * cosineWeightedIrradiance;
	vec3 indirectDiffuse = diffuse * cosineWeightedIrradiance;
	#ifdef USE_SHEEN
		float sheenAlbedo = IBLSheenBRDF( geometryNormal, geometryViewDir, material.sheenRoughness );
		float sheenEnergyComp = 1.0 - max3( material.sheenColor ) * sheenAlbedo;
		indirectSpecular *= sheenEnergyComp;
		indirectDiffuse *= sheenEnergyComp;
	#endif
	reflectedLight.indirectSpecular += indirectSpecular;
	reflectedLight.indirectDiffuse += indirectDiffuse;
}
#define RE_Direct				RE_Direct_Physical
#define RE_Direct_RectArea		RE_Direct_RectArea_Physical
#define RE_IndirectDiffuse		RE_IndirectDiffuse_Physical
#define RE_IndirectSpecular		RE_IndirectSpecular_Physical
float computeSpecularOcclusion( const in float dotNV, const in float ambientOcclusion, const in float roughness ) {
	return saturate( pow( dotNV + ambientOcclusion, exp2( - 16.0 * roughness - 1.0 ) ) - 1.0 + ambientOcclusion );
}`,lights_fragment_begin:`
vec3 geometryPosition = - vViewPosition;
vec3 geometryNormal = normal;
vec3 geometryViewDir = ( isOrthographic ) ? vec3( 0, 0, 1 ) : normalize( vViewPosition );
vec3 geometryClearcoatNormal = vec3( 0.0 );
#ifdef USE_CLEARCOAT
	geometryClearcoatNormal = clearcoatNormal;
#endif
#ifdef USE_IRIDESCENCE
	float dotNVi = saturate( dot( normal, geometryViewDir ) );
	if ( material.iridescenceThickness == 0.0 ) {
		material.iridescence = 0.0;
	} else {
		material.iridescence = saturate( material.iridescence );
	}
	if ( material.iridescence > 0.0 ) {
		vec3 iridescenceFresnelDielectric = evalIridescence( 1.0, material.iridescenceIOR, dotNVi, material.iridescenceThickness, material.specularColor );
		vec3 iridescenceFresnelMetallic = evalIridescence( 1.0, material.iridescenceIOR, dotNVi, material.iridescenceThickness, material.diffuseColor );
		material.iridescenceFresnel = mix( iridescenceFresnelDielectric, iridescenceFresnelMetallic, material.metalness );
		material.iridescenceF0Dielectric = Schlick_to_F0( iridescenceFresnelDielectric, 1.0, dotNVi );
		material.iridescenceF0Metallic = Schlick_to_F0( iridescenceFresnelMetallic, 1.0, dotNVi );
	}
#endif
#ifdef STANDARD
	float dotNVms = saturate( dot( geometryNormal, geometryViewDir ) );
	material.dfg = texture2D( dfgLUT, vec2( material.roughness, dotNVms ) ).rg;
	#if ( NUM_SUN_LIGHTS > 0 || NUM_DIR_LIGHTS > 0 || NUM_POINT_LIGHTS > 0 || NUM_SPOT_LIGHTS > 0 )
		float EssMs = material.dfg.x + material.dfg.y;
		material.multiScatteringCompensation = 1.0 + material.specularColorBlended * ( 1.0 / EssMs - 1.0 );
	#endif
#endif
IncidentLight directLight;
#if ( NUM_POINT_LIGHTS > 0 ) && defined( RE_Direct )
	PointLight pointLight;
	#if defined( USE_SHADOWMAP ) && NUM_POINT_LIGHT_SHADOWS > 0
	PointLightShadow pointLightShadow;
	#endif
	#pragma unroll_loop_start
	for ( int i = 0; i < NUM_POINT_LIGHTS; i ++ ) {
		pointLight = pointLights[ i ];
		getPointLightInfo( pointLight, geometryPosition, directLight );
		#if defined( USE_SHADOWMAP ) && ( UNROLLED_LOOP_INDEX < NUM_POINT_LIGHT_SHADOWS ) && ( defined( SHADOWMAP_TYPE_PCF ) || defined( SHADOWMAP_TYPE_BASIC ) )
		pointLightShadow = pointLightShadows[ i ];
		directLight.color *= ( directLight.visible && receiveShadow ) ? getPointShadow( pointShadowMap[ i ], pointLightShadow.shadowMapSize, pointLightShadow.shadowIntensity, pointLightShadow.shadowBias, pointLightShadow.shadowRadius, vPointShadowCoord[ i ], pointLightShadow.shadowCameraNear, pointLightShadow.shadowCameraFar ) : 1.0;
		#endif
		RE_Direct( directLight, geometryPosition, geometryNormal, geometryViewDir, geometryClearcoatNormal, material, reflectedLight );
	}
	#pragma unroll_loop_end
#endif
#if ( NUM_SPOT_LIGHTS > 0 ) && defined( RE_Direct )
	SpotLight spotLight;
	vec4 spotColor;
	vec3 spotLightCoord;
	bool inSpotLightMap;
	#if defined( USE_SHADOWMAP ) && NUM_SPOT_LIGHT_SHADOWS > 0
	SpotLightShadow spotLightShadow;
	#endif
	#pragma unroll_loop_start
	for ( int i = 0; i < NUM_SPOT_LIGHTS; i ++ ) {
		spotLight = spotLights[ i ];
		getSpotLightInfo( spotLight, geometryPosition, directLight );
		#if ( UNROLLED_LOOP_INDEX < NUM_SPOT_LIGHT_SHADOWS_WITH_MAPS )
		#define SPOT_LIGHT_MAP_INDEX UNROLLED_LOOP_INDEX
		#elif ( UNROLLED_LOOP_INDEX < NUM_SPOT_LIGHT_SHADOWS )
		#define SPOT_LIGHT_MAP_INDEX NUM_SPOT_LIGHT_MAPS
		#else
		#define SPOT_LIGHT_MAP_INDEX ( UNROLLED_LOOP_INDEX - NUM_SPOT_LIGHT_SHADOWS + NUM_SPOT_LIGHT_SHADOWS_WITH_MAPS )
		#endif
		#if ( SPOT_LIGHT_MAP_INDEX < NUM_SPOT_LIGHT_MAPS )
			spotLightCoord = vSpotLightCoord[ i ].xyz / vSpotLightCoord[ i ].w;
			inSpotLightMap = all( lessThan( abs( spotLightCoord * 2. - 1. ), vec3( 1.0 ) ) );
			spotColor = texture2D( spotLightMap[ SPOT_LIGHT_MAP_INDEX ], spotLightCoord.xy );
			directLight.color = inSpotLightMap ? directLight.color * spotColor.rgb : directLight.color;
		#endif
		#undef SPOT_LIGHT_MAP_INDEX
		#if defined( USE_SHADOWMAP ) && ( UNROLLED_LOOP_INDEX < NUM_SPOT_LIGHT_SHADOWS )
		spotLightShadow = spotLightShadows[ i ];
		directLight.color *= ( directLight.visible && receiveShadow ) ? getShadow( spotShadowMap[ i ], spotLightShadow.shadowMapSize, spotLightShadow.shadowIntensity, spotLightShadow.shadowBias, spotLightShadow.shadowRadius, vSpotLightCoord[ i ] ) : 1.0;
		#endif
		RE_Direct( directLight, geometryPosition, geometryNormal, geometryViewDir, geometryClearcoatNormal, material, reflectedLight );
	}
	#pragma unroll_loop_end
#endif
#if ( NUM_SUN_LIGHTS > 0 ) && defined( RE_Direct )
	SunLight sunLight;
	#if defined( USE_SHADOWMAP ) && NUM_SUN_LIGHT_SHADOWS > 0
	SunLightShadow sunLightShadow;
	#endif
	#pragma unroll_loop_start
	for ( int i = 0; i < NUM_SUN_LIGHTS; i ++ ) {
		sunLight = sunLights[ i ];
		getSunLightInfo( sunLight, directLight );
		#if defined( USE_SHADOWMAP ) && ( UNROLLED_LOOP_INDEX < NUM_SUN_LIGHT_SHADOWS )
		sunLightShadow = sunLightShadows[ i ];
		directLight.color *= ( directLight.visible && receiveShadow ) ? getSunShadow( sunShadowMap[ i ], sunLightShadow, UNROLLED_LOOP_INDEX ) : 1.0;
		#endif
		RE_Direct( directLight, geometryPosition, geometryNormal, geometryViewDir, geometryClearcoatNormal, material, reflectedLight );
	}
	#pragma unroll_loop_end
#endif
#if ( NUM_DIR_LIGHTS > 0 ) && defined( RE_Direct )
	DirectionalLight directionalLight;
	#if defined( USE_SHADOWMAP ) && NUM_DIR_LIGHT_SHADOWS > 0
	DirectionalLightShadow directionalLightShadow;
	#endif
	#pragma unroll_loop_start
	for ( int i = 0; i < NUM_DIR_LIGHTS; i ++ ) {
		directionalLight = directionalLights[ i ];
		getDirectionalLightInfo( directionalLight, directLight );
		#if defined( USE_SHADOWMAP ) && ( UNROLLED_LOOP_INDEX < NUM_DIR_LIGHT_SHADOWS )
		directionalLightShadow = directionalLightShadows[ i ];
		directLight.color *= ( directLight.visible && receiveShadow ) ? getShadow( directionalShadowMap[ i ], directionalLightShadow.shadowMapSize, directionalLightShadow.shadowIntensity, directionalLightShadow.shadowBias, directionalLightShadow.shadowRadius, vDirectionalShadowCoord[ i ] ) : 1.0;
		#endif
		RE_Direct( directLight, geometryPosition, geometryNormal, geometryViewDir, geometryClearcoatNormal, material, reflectedLight );
	}
	#pragma unroll_loop_end
#endif
#if ( NUM_RECT_AREA_LIGHTS > 0 ) && defined( RE_Direct_RectArea )
	RectAreaLight rectAreaLight;
	#pragma unroll_loop_start
	for ( int i = 0; i < NUM_RECT_AREA_LIGHTS; i ++ ) {
		rectAreaLight = rectAreaLights[ i ];
		RE_Direct_RectArea( rectAreaLight, geometryPosition, geometryNormal, geometryViewDir, geometryClearcoatNormal, material, reflectedLight );
	}
	#pragma unroll_loop_end
#endif
#if defined( RE_IndirectDiffuse )
	vec3 iblIrradiance = vec3( 0.0 );
	vec3 irradiance = getAmbientLightIrradiance( ambientLightColor );
	#if defined( USE_LIGHT_PROBES )
		irradiance += getLightProbeIrradiance( lightProbe, geometryNormal );
	#endif
	#if ( NUM_HEMI_LIGHTS > 0 )
		#pragma unroll_loop_start
		for ( int i = 0; i < NUM_HEMI_LIGHTS; i ++ ) {
			irradiance += getHemisphereLightIrradiance( hemisphereLights[ i ], geometryNormal );
		}
		#pragma unroll_loop_end
	#endif
	#if NUM_LIGHT_PROBE_GRIDS > 0
		vec3 probeWorldPos = ( ( vec4( geometryPosition, 1.0 ) - viewMatrix[ 3 ] ) * viewMatrix ).xyz;
		vec3 probeWorldNormal = transformNormalByInverseViewMatrix( geometryNormal, viewMatrix );
		int probeGrid = - 1;
		#pragma unroll_loop_start
		for ( int i = 0; i < NUM_LIGHT_PROBE_GRIDS; i ++ ) {
			if ( isInsideLightProbeGrid( probeWorldPos, probeWorldNormal, probesMin[ i ], probesMax[ i ], probesResolution[ i ] ) ) probeGrid = UNROLLED_LOOP_INDEX;
		}
		#pragma unroll_loop_end
		#pragma unroll_loop_start
		for ( int i = 0; i < NUM_LIGHT_PROBE_GRIDS; i ++ ) {
			if ( probeGrid == UNROLLED_LOOP_INDEX ) irradiance += getLightProbeGridIrradiance( probesSH[ i ], probesMin[ i ], probesMax[ i ], probesResolution[ i ], probeWorldPos, probeWorldNormal );
		}
		#pragma unroll_loop_end
	#endif
#endif
#if defined( RE_IndirectSpecular )
	vec3 radiance = vec3( 0.0 );
	vec3 clearcoatRadiance = vec3( 0.0 );
#endif`,lights_fragment_maps:`#if defined( RE_IndirectDiffuse )
	#ifdef USE_LIGHTMAP
		vec4 lightMapTexel = texture2D( lightMap, vLightMapUv );
		vec3 lightMapIrradiance = lightMapTexel.rgb * lightMapIntensity;
		irradiance += lightMapIrradiance;
	#endif
	#if defined( USE_ENVMAP ) && defined( ENVMAP_TYPE_PMREM )
		#if defined( STANDARD ) || defined( LAMBERT ) || defined( PHONG )
			iblIrradiance += getIBLIrradiance( geometryNormal );
		#endif
	#endif
#endif
#if defined( USE_ENVMAP ) && defined( RE_IndirectSpecular )
	#ifdef USE_ANISOTROPY
		vec3 iblRadiance = getIBLAnisotropyRadiance( geometryViewDir, geometryNormal, material.roughness, material.anisotropyB, material.anisotropy );
	#else
		vec3 iblRadiance = getIBLRadiance( geometryViewDir, geometryNormal, material.roughness );
	#endif
	#ifdef USE_RETROREFLECTION
		#ifdef USE_ANISOTROPY
			vec3 retroIBLRadiance = getIBLAnisotropyRetroRadiance( geometryViewDir, geometryNormal, material.roughness, material.anisotropyB, material.anisotropy );
		#else
			vec3 retroIBLRadiance = getIBLRetroRadiance( geometryViewDir, geometryNormal, material.roughness );
		#endif
		iblRadiance = mix( iblRadiance, retroIBLRadiance, saturate( material.retroreflectivity ) );
	#endif
	radiance += iblRadiance;
	#ifdef USE_CLEARCOAT
		clearcoatRadiance += getIBLRadiance( geometryViewDir, geometryClearcoatNormal, material.clearcoatRoughness );
	#endif
#endif`,lights_fragment_end:`#if defined( RE_IndirectDiffuse )
	#if defined( LAMBERT ) || defined( PHONG )
		irradiance += iblIrradiance;
	#endif
	RE_IndirectDiffuse( irradiance, geometryPosition, geometryNormal, geometryViewDir, geometryClearcoatNormal, material, reflectedLight );
#endif
#if defined( RE_IndirectSpecular )
	RE_IndirectSpecular( radiance, iblIrradiance, clearcoatRadiance, geometryPosition, geometryNormal, geometryViewDir, geometryClearcoatNormal, material, reflectedLight );
#endif`,lightprobes_pars_fragment:`#if NUM_LIGHT_PROBE_GRIDS > 0
uniform highp sampler3D probesSH[ NUM_LIGHT_PROBE_GRIDS ];
uniform vec3 probesMin[ NUM_LIGHT_PROBE_GRIDS ];
uniform vec3 probesMax[ NUM_LIGHT_PROBE_GRIDS ];
uniform vec3 probesResolution[ NUM_LIGHT_PROBE_GRIDS ];
bool isInsideLightProbeGrid( vec3 worldPos, vec3 worldNormal, vec3 probesMin, vec3 probesMax, vec3 probesResolution ) {
	vec3 spacing = ( probesMax - probesMin ) / probesResolution;
	vec3 samplePos = worldPos + worldNormal * spacing * 0.5;
	vec3 margin = spacing * 0.01;
	return all( greaterThanEqual( samplePos, probesMin - margin ) ) && all( lessThanEqual( samplePos, probesMax + margin ) );
}
vec3 getLightProbeGridIrradiance( highp sampler3D probesSH, vec3 probesMin, vec3 probesMax, vec3 probesResolution, vec3 worldPos, vec3 worldNormal ) {
	vec3 res = probesResolution;
	vec3 gridRange = probesMax - probesMin;
	vec3 probeSpacing = gridRange / res;
	vec3 samplePos = worldPos + worldNormal * probeSpacing * 0.5;
	vec3 uvw = clamp( ( samplePos - probesMin ) / gridRange, 0.5 / res, 1.0 - 0.5 / res );
	float nz          = res.z;
	float paddedSlices = nz + 2.0;
	float atlasDepth  = 7.0 * paddedSlices;
	float uvZBase     = uvw.z * nz + 1.0;
	vec4 s0 = texture( probesSH, vec3( uvw.xy, ( uvZBase                       ) / atlasDepth ) );
	vec4 s1 = texture( probesSH, vec3( uvw.xy, ( uvZBase +       paddedSlices   ) / atlasDepth ) );
	vec4 s2 = texture( probesSH, vec3( uvw.xy, ( uvZBase + 2.0 * paddedSlices   ) / atlasDepth ) );
	vec4 s3 = texture( probesSH, vec3( uvw.xy, ( uvZBase + 3.0 * paddedSlices   ) / atlasDepth ) );
	vec4 s4 = texture( probesSH, vec3( uvw.xy, ( uvZBase + 4.0 * paddedSlices   ) / atlasDepth ) );
	vec4 s5 = texture( probesSH, vec3( uvw.xy, ( uvZBase + 5.0 * paddedSlices   ) / atlasDepth ) );
	vec4 s6 = texture( probesSH, vec3( uvw.xy, ( uvZBase + 6.0 * paddedSlices   ) / atlasDepth ) );
	vec3 c0 = s0.xyz;
	vec3 c1 = vec3( s0.w, s1.xy );
	vec3 c2 = vec3( s1.zw, s2.x );
	vec3 c3 = s2.yzw;
	vec3 c4 = s3.xyz;
	vec3 c5 = vec3( s3.w, s4.xy );
	vec3 c6 = vec3( s4.zw, s5.x );
	vec3 c7 = s5.yzw;
	vec3 c8 = s6.xyz;
	float x = worldNormal.x, y = worldNormal.y, z = worldNormal.z;
	vec3 result = c0 * 0.886227;
	result += c1 * 2.0 * 0.511664 * y;
	result += c2 * 2.0 * 0.511664 * z;
	result += c3 * 2.0 * 0.511664 * x;
	result += c4 * 2.0 * 0.429043 * x * y;
	result += c5 * 2.0 * 0.429043 * y * z;
	result += c6 * ( 0.743125 * z * z - 0.247708 );
	result += c7 * 2.0 * 0.429043 * x * z;
	result += c8 * 0.429043 * ( x * x - y * y );
	return max( result, vec3( 0.0 ) );
}
#endif`,logdepthbuf_fragment:`#if defined( USE_LOGARITHMIC_DEPTH_BUFFER )
	gl_FragDepth = vIsPerspective == 0.0 ? gl_FragCoord.z : log2( vFragDepth ) * logDepthBufFC * 0.5;
#endif`,logdepthbuf_pars_fragment:`#if defined( USE_LOGARITHMIC_DEPTH_BUFFER )
	uniform float logDepthBufFC;
	varying float vFragDepth;
	varying float vIsPerspective;
#endif`,logdepthbuf_pars_vertex:`#ifdef USE_LOGARITHMIC_DEPTH_BUFFER
	varying float vFragDepth;
	varying float vIsPerspective;
#endif`,logdepthbuf_vertex:`#ifdef USE_LOGARITHMIC_DEPTH_BUFFER
	vFragDepth = 1.0 + gl_Position.w;
	vIsPerspective = float( isPerspectiveMatrix( projectionMatrix ) );
#endif`,map_fragment:`#ifdef USE_MAP
	vec4 sampledDiffuseColor = texture2D( map, vMapUv );
	#ifdef DECODE_VIDEO_TEXTURE
		sampledDiffuseColor = sRGBTransferEOTF( sampledDiffuseColor );
	#endif
	diffuseColor *= sampledDiffuseColor;
#endif`,map_pars_fragment:`#ifdef USE_MAP
	uniform sampler2D map;
#endif`,map_particle_fragment:`#if defined( USE_MAP ) || defined( USE_ALPHAMAP )
	#if defined( USE_POINTS_UV )
		vec2 uv = vUv;
	#else
		vec2 uv = ( uvTransform * vec3( gl_PointCoord.x, 1.0 - gl_PointCoord.y, 1 ) ).xy;
	#endif
#endif
#ifdef USE_MAP
	diffuseColor *= texture2D( map, uv );
#endif
#ifdef USE_ALPHAMAP
	diffuseColor.a *= texture2D( alphaMap, uv ).g;
#endif`,map_particle_pars_fragment:`#if defined( USE_POINTS_UV )
	varying vec2 vUv;
#else
	#if defined( USE_MAP ) || defined( USE_ALPHAMAP )
		uniform mat3 uvTransform;
	#endif
#endif
#ifdef USE_MAP
	uniform sampler2D map;
#endif
#ifdef USE_ALPHAMAP
	uniform sampler2D alphaMap;
#endif`,metalnessmap_fragment:`float metalnessFactor = metalness;
#ifdef USE_METALNESSMAP
	vec4 texelMetalness = texture2D( metalnessMap, vMetalnessMapUv );
	metalnessFactor *= texelMetalness.b;
#endif`,metalnessmap_pars_fragment:`#ifdef USE_METALNESSMAP
	uniform sampler2D metalnessMap;
#endif`,morphinstance_vertex:`#ifdef USE_INSTANCING_MORPH
	float morphTargetInfluences[ MORPHTARGETS_COUNT ];
	float morphTargetBaseInfluence = texelFetch( morphTexture, ivec2( 0, gl_InstanceID ), 0 ).r;
	for ( int i = 0; i < MORPHTARGETS_COUNT; i ++ ) {
		morphTargetInfluences[i] =  texelFetch( morphTexture, ivec2( i + 1, gl_InstanceID ), 0 ).r;
	}
#endif`,morphcolor_vertex:`#if defined( USE_MORPHCOLORS )
	#if defined( USE_COLOR_ALPHA )
		vColor *= morphTargetBaseInfluence;
	#elif defined( USE_COLOR )
		vColor.rgb *= morphTargetBaseInfluence;
	#endif
	for ( int i = 0; i < MORPHTARGETS_COUNT; i ++ ) {
		#if defined( USE_COLOR_ALPHA )
			if ( morphTargetInfluences[ i ] != 0.0 ) vColor += getMorph( gl_VertexID, i, 2 ) * morphTargetInfluences[ i ];
		#elif defined( USE_COLOR )
			if ( morphTargetInfluences[ i ] != 0.0 ) vColor.rgb += getMorph( gl_VertexID, i, 2 ).rgb * morphTargetInfluences[ i ];
		#endif
	}
#endif`,morphnormal_vertex:`#ifdef USE_MORPHNORMALS
	objectNormal *= morphTargetBaseInfluence;
	for ( int i = 0; i < MORPHTARGETS_COUNT; i ++ ) {
		if ( morphTargetInfluences[ i ] != 0.0 ) objectNormal += getMorph( gl_VertexID, i, 1 ).xyz * morphTargetInfluences[ i ];
	}
#endif`,morphtarget_pars_vertex:`#ifdef USE_MORPHTARGETS
	#ifndef USE_INSTANCING_MORPH
		uniform float morphTargetBaseInfluence;
		uniform float morphTargetInfluences[ MORPHTARGETS_COUNT ];
	#endif
	uniform sampler2DArray morphTargetsTexture;
	uniform ivec2 morphTargetsTextureSize;
	vec4 getMorph( const in int vertexIndex, const in int morphTargetIndex, const in int offset ) {
		int texelIndex = vertexIndex * MORPHTARGETS_TEXTURE_STRIDE + offset;
		int y = texelIndex / morphTargetsTextureSize.x;
		int x = texelIndex - y * morphTargetsTextureSize.x;
		ivec3 morphUV = ivec3( x, y, morphTargetIndex );
		return texelFetch( morphTargetsTexture, morphUV, 0 );
	}
#endif`,morphtarget_vertex:`#ifdef USE_MORPHTARGETS
	transformed *= morphTargetBaseInfluence;
	for ( int i = 0; i < MORPHTARGETS_COUNT; i ++ ) {
		if ( morphTargetInfluences[ i ] != 0.0 ) transformed += getMorph( gl_VertexID, i, 0 ).xyz * morphTargetInfluences[ i ];
	}
#endif`,normal_fragment_begin:`float faceDirection = gl_FrontFacing ? 1.0 : - 1.0;
#ifdef FLAT_SHADED
	vec3 fdx = dFdx( vViewPosition );
	vec3 fdy = dFdy( vViewPosition );
	vec3 normal = normalize( cross( fdx, fdy ) );
#else
	vec3 normal = normalize( vNormal );
	#ifdef DOUBLE_SIDED
		normal *= faceDirection;
	#endif
#endif
#if defined( USE_NORMALMAP_TANGENTSPACE ) || defined( USE_CLEARCOAT_NORMALMAP ) || defined( USE_ANISOTROPY )
	#ifdef USE_TANGENT
		mat3 tbn = mat3( normalize( vTangent ), normalize( vBitangent ), normal );
	#else
		mat3 tbn = getTangentFrame( - vViewPosition, normal,
		#if defined( USE_NORMALMAP )
			vNormalMapUv
		#elif defined( USE_CLEARCOAT_NORMALMAP )
			vClearcoatNormalMapUv
		#else
			vUv
		#endif
		);
	#endif
	#ifdef DOUBLE_SIDED
		tbn[0] *= faceDirection;
		tbn[1] *= faceDirection;
	#endif
#endif
#ifdef USE_CLEARCOAT_NORMALMAP
	#ifdef USE_TANGENT
		mat3 tbn2 = mat3( normalize( vTangent ), normalize( vBitangent ), normal );
	#else
		mat3 tbn2 = getTangentFrame( - vViewPosition, normal, vClearcoatNormalMapUv );
	#endif
	#ifdef DOUBLE_SIDED
		tbn2[0] *= faceDirection;
		tbn2[1] *= faceDirection;
	#endif
#endif
vec3 nonPerturbedNormal = normal;`,normal_fragment_maps:`#ifdef USE_NORMALMAP_OBJECTSPACE
	normal = texture2D( normalMap, vNormalMapUv ).xyz * 2.0 - 1.0;
	#ifdef FLIP_SIDED
		normal = - normal;
	#endif
	#ifdef DOUBLE_SIDED
		normal = normal * faceDirection;
	#endif
	normal = normalize( normalMatrix * normal );
#elif defined( USE_NORMALMAP_TANGENTSPACE )
	vec3 mapN = texture2D( normalMap, vNormalMapUv ).xyz * 2.0 - 1.0;
	#if defined( USE_PACKED_NORMALMAP )
		mapN = vec3( mapN.xy, sqrt( saturate( 1.0 - dot( mapN.xy, mapN.xy ) ) ) );
	#endif
	mapN.xy *= normalScale;
	normal = normalize( tbn * mapN );
#elif defined( USE_BUMPMAP )
	normal = perturbNormalArb( - vViewPosition, normal, dHdxy_fwd(), faceDirection );
#endif`,normal_pars_fragment:`#ifndef FLAT_SHADED
	varying vec3 vNormal;
	#ifdef USE_TANGENT
		varying vec3 vTangent;
		varying vec3 vBitangent;
	#endif
#endif`,normal_pars_vertex:`#ifndef FLAT_SHADED
	varying vec3 vNormal;
	#ifdef USE_TANGENT
		varying vec3 vTangent;
		varying vec3 vBitangent;
	#endif
#endif`,normal_vertex:`#ifndef FLAT_SHADED
	vNormal = normalize( transformedNormal );
	#ifdef USE_TANGENT
		vTangent = normalize( transformedTangent );
		vBitangent = normalize( cross( vNormal, vTangent ) * tangent.w );
		#ifdef FLIP_SIDED
			vBitangent = - vBitangent;
		#endif
	#endif
#endif`,normalmap_pars_fragment:`#ifdef USE_NORMALMAP
	uniform sampler2D normalMap;
	uniform vec2 normalScale;
#endif
#ifdef USE_NORMALMAP_OBJECTSPACE
	uniform mat3 normalMatrix;
#endif
#if ! defined ( USE_TANGENT ) && ( defined ( USE_NORMALMAP_TANGENTSPACE ) || defined ( USE_CLEARCOAT_NORMALMAP ) || defined( USE_ANISOTROPY ) )
	mat3 getTangentFrame( vec3 eye_pos, vec3 surf_norm, vec2 uv ) {
		vec3 q0 = dFdx( eye_pos.xyz );
		vec3 q1 = dFdy( eye_pos.xyz );
		vec2 st0 = dFdx( uv.st );
		vec2 st1 = dFdy( uv.st );
		vec3 N = surf_norm;
		vec3 q1perp = cross( q1, N );
		vec3 q0perp = cross( N, q0 );
		vec3 T = q1perp * st0.x + q0perp * st1.x;
		vec3 B = q1perp * st0.y + q0perp * st1.y;
		float det = max( dot( T, T ), dot( B, B ) );
		float scale = ( det == 0.0 ) ? 0.0 : inversesqrt( det );
		return mat3( T * scale, B * scale, N );
	}
#endif`,clearcoat_normal_fragment_begin:`#ifdef USE_CLEARCOAT
	vec3 clearcoatNormal = nonPerturbedNormal;
#endif`,clearcoat_normal_fragment_maps:`#ifdef USE_CLEARCOAT_NORMALMAP
	vec3 clearcoatMapN = texture2D( clearcoatNormalMap, vClearcoatNormalMapUv ).xyz * 2.0 - 1.0;
	clearcoatMapN.xy *= clearcoatNormalScale;
	clearcoatNormal = normalize( tbn2 * clearcoatMapN );
#endif`,clearcoat_pars_fragment:`#ifdef USE_CLEARCOATMAP
	uniform sampler2D clearcoatMap;
#endif
#ifdef USE_CLEARCOAT_NORMALMAP
	uniform sampler2D clearcoatNormalMap;
	uniform vec2 clearcoatNormalScale;
#endif
#ifdef USE_CLEARCOAT_ROUGHNESSMAP
	uniform sampler2D clearcoatRoughnessMap;
#endif`,iridescence_pars_fragment:`#ifdef USE_IRIDESCENCEMAP
	uniform sampler2D iridescenceMap;
#endif
#ifdef USE_IRIDESCENCE_THICKNESSMAP
	uniform sampler2D iridescenceThicknessMap;
#endif`,opaque_fragment:`#ifdef OPAQUE
diffuseColor.a = 1.0;
#endif
#ifdef USE_TRANSMISSION
diffuseColor.a *= material.transmissionAlpha;
#endif
gl_FragColor = vec4( outgoingLight, diffuseColor.a );`,packing:`vec3 packNormalToRGB( const in vec3 normal ) {
	return normalize( normal ) * 0.5 + 0.5;
}
vec3 unpackRGBToNormal( const in vec3 rgb ) {
	return 2.0 * rgb.xyz - 1.0;
}
const float PackUpscale = 256. / 255.;const float UnpackDownscale = 255. / 256.;const float ShiftRight8 = 1. / 256.;
const float Inv255 = 1. / 255.;
const vec4 PackFactors = vec4( 1.0, 256.0, 256.0 * 256.0, 256.0 * 256.0 * 256.0 );
const vec2 UnpackFactors2 = vec2( UnpackDownscale, 1.0 / PackFactors.g );
const vec3 UnpackFactors3 = vec3( UnpackDownscale / PackFactors.rg, 1.0 / PackFactors.b );
const vec4 UnpackFactors4 = vec4( UnpackDownscale / PackFactors.rgb, 1.0 / PackFactors.a );
vec4 packDepthToRGBA( const in float v ) {
	if( v <= 0.0 )
		return vec4( 0., 0., 0., 0. );
	if( v >= 1.0 )
		return vec4( 1., 1., 1., 1. );
	float vuf;
	float af = modf( v * PackFactors.a, vuf );
	float bf = modf( vuf * ShiftRight8, vuf );
	float gf = modf( vuf * ShiftRight8, vuf );
	return vec4( vuf * Inv255, gf * PackUpscale, bf * PackUpscale, af );
}
vec3 packDepthToRGB( const in float v ) {
	if( v <= 0.0 )
		return vec3( 0., 0., 0. );
	if( v >= 1.0 )
		return vec3( 1., 1., 1. );
	float vuf;
	float bf = modf( v * PackFactors.b, vuf );
	float gf = modf( vuf * ShiftRight8, vuf );
	return vec3( vuf * Inv255, gf * PackUpscale, bf );
}
vec2 packDepthToRG( const in float v ) {
	if( v <= 0.0 )
		return vec2( 0., 0. );
	if( v >= 1.0 )
		return vec2( 1., 1. );
	float vuf;
	float gf = modf( v * 256., vuf );
	return vec2( vuf * Inv255, gf );
}
float unpackRGBAToDepth( const in vec4 v ) {
	return dot( v, UnpackFactors4 );
}
float unpackRGBToDepth( const in vec3 v ) {
	return dot( v, UnpackFactors3 );
}
float unpackRGToDepth( const in vec2 v ) {
	return v.r * UnpackFactors2.r + v.g * UnpackFactors2.g;
}
vec4 pack2HalfToRGBA( const in vec2 v ) {
	vec4 r = vec4( v.x, fract( v.x * 255.0 ), v.y, fract( v.y * 255.0 ) );
	return vec4( r.x - r.y / 255.0, r.y, r.z - r.w / 255.0, r.w );
}
vec2 unpackRGBATo2Half( const in vec4 v ) {
	return vec2( v.x + ( v.y / 255.0 ), v.z + ( v.w / 255.0 ) );
}
float viewZToOrthographicDepth( const in float viewZ, const in float near, const in float far ) {
	return ( viewZ + near ) / ( near - far );
}
float orthographicDepthToViewZ( const in float depth, const in float near, const in float far ) {
	#ifdef USE_REVERSED_DEPTH_BUFFER
	
		return depth * ( far - near ) - far;
	#else
		return depth * ( near - far ) - near;
	#endif
}
float viewZToPerspectiveDepth( const in float viewZ, const in float near, const in float far ) {
	return ( ( near + viewZ ) * far ) / ( ( far - near ) * viewZ );
}
float perspectiveDepthToViewZ( const in float depth, const in float near, const in float far ) {
	
	#ifdef USE_REVERSED_DEPTH_BUFFER
		return ( near * far ) / ( ( near - far ) * depth - near );
	#else
		return ( near * far ) / ( ( far - near ) * depth - far );
	#endif
}`,premultiplied_alpha_fragment:`#ifdef PREMULTIPLIED_ALPHA
	gl_FragColor.rgb *= gl_FragColor.a;
#endif`,project_vertex:`vec4 mvPosition = vec4( transformed, 1.0 );
#ifdef USE_BATCHING
	mvPosition = batchingMatrix * mvPosition;
#endif
#ifdef USE_INSTANCING
	mvPosition = instanceMatrix * mvPosition;
#endif
mvPosition = modelViewMatrix * mvPosition;
gl_Position = projectionMatrix * mvPosition;`,dithering_fragment:`#ifdef DITHERING
	gl_FragColor.rgb = dithering( gl_FragColor.rgb );
#endif`,dithering_pars_fragment:`#ifdef DITHERING
	vec3 dithering( vec3 color ) {
		float grid_position = rand( gl_FragCoord.xy );
		vec3 dither_shift_RGB = vec3( 0.25 / 255.0, -0.25 / 255.0, 0.25 / 255.0 );
		dither_shift_RGB = mix( 2.0 * dither_shift_RGB, -2.0 * dither_shift_RGB, grid_position );
		return color + dither_shift_RGB;
	}
#endif`,roughnessmap_fragment:`float roughnessFactor = roughness;
#ifdef USE_ROUGHNESSMAP
	vec4 texelRoughness = texture2D( roughnessMap, vRoughnessMapUv );
	roughnessFactor *= texelRoughness.g;
#endif`,roughnessmap_pars_fragment:`#ifdef USE_ROUGHNESSMAP
	uniform sampler2D roughnessMap;
#endif`,shadowmap_pars_fragment:`#if NUM_SPOT_LIGHT_COORDS > 0
	varying vec4 vSpotLightCoord[ NUM_SPOT_LIGHT_COORDS ];
#endif
#if NUM_SPOT_LIGHT_MAPS > 0
	uniform sampler2D spotLightMap[ NUM_SPOT_LIGHT_MAPS ];
#endif
#ifdef USE_SHADOWMAP
	#if NUM_SUN_LIGHT_SHADOWS > 0
		#define SUN_LIGHT_CASCADES 2
		#if defined( SHADOWMAP_TYPE_PCF )
			uniform sampler2DShadow sunShadowMap[ NUM_SUN_LIGHT_SHADOWS ];
		#else
			uniform sampler2D sunShadowMap[ NUM_SUN_LIGHT_SHADOWS ];
		#endif
		uniform mat4 sunShadowMatrix[ NUM_SUN_LIGHT_SHADOWS * SUN_LIGHT_CASCADES ];
		uniform vec4 sunShadowCascade[ NUM_SUN_LIGHT_SHADOWS * SUN_LIGHT_CASCADES ];
		varying vec4 vSunShadowWorldPosition;
		varying vec3 vSunShadowWorldNormal;
		struct SunLightShadow {
			float shadowIntensity;
			float shadowBias;
			float shadowNormalBias;
			float shadowRadius;
			vec2 shadowMapSize;
		};
		uniform SunLightShadow sunLightShadows[ NUM_SUN_LIGHT_SHADOWS ];
	#endif
	#if NUM_DIR_LIGHT_SHADOWS > 0
		#if defined( SHADOWMAP_TYPE_PCF )
			uniform sampler2DShadow directionalShadowMap[ NUM_DIR_LIGHT_SHADOWS ];
		#else
			uniform sampler2D directionalShadowMap[ NUM_DIR_LIGHT_SHADOWS ];
		#endif
		varying vec4 vDirectionalShadowCoord[ NUM_DIR_LIGHT_SHADOWS ];
		struct DirectionalLightShadow {
			float shadowIntensity;
			float shadowBias;
			float shadowNormalBias;
			float shadowRadius;
			vec2 shadowMapSize;
		};
		uniform DirectionalLightShadow directionalLightShadows[ NUM_DIR_LIGHT_SHADOWS ];
	#endif
	#if NUM_SPOT_LIGHT_SHADOWS > 0
		#if defined( SHADOWMAP_TYPE_PCF )
			uniform sampler2DShadow spotShadowMap[ NUM_SPOT_LIGHT_SHADOWS ];
		#else
			uniform sampler2D spotShadowMap[ NUM_SPOT_LIGHT_SHADOWS ];
		#endif
		struct SpotLightShadow {
			float shadowIntensity;
			float shadowBias;
			float shadowNormalBias;
			float shadowRadius;
			vec2 shadowMapSize;
		};
		uniform SpotLightShadow spotLightShadows[ NUM_SPOT_LIGHT_SHADOWS ];
	#endif
	#if NUM_POINT_LIGHT_SHADOWS > 0
		#if defined( SHADOWMAP_TYPE_PCF )
			uniform samplerCubeShadow pointShadowMap[ NUM_POINT_LIGHT_SHADOWS ];
		#elif defined( SHADOWMAP_TYPE_BASIC )
			uniform samplerCube pointShadowMap[ NUM_POINT_LIGHT_SHADOWS ];
		#endif
		varying vec4 vPointShadowCoord[ NUM_POINT_LIGHT_SHADOWS ];
		struct PointLightShadow {
			float shadowIntensity;
			float shadowBias;
			float shadowNormalBias;
			float shadowRadius;
			vec2 shadowMapSize;
			float shadowCameraNear;
			float shadowCameraFar;
		};
		uniform PointLightShadow pointLightShadows[ NUM_POINT_LIGHT_SHADOWS ];
	#endif
	#if defined( SHADOWMAP_TYPE_PCF )
		float interleavedGradientNoise( vec2 position ) {
			return fract( 52.9829189 * fract( dot( position, vec2( 0.06711056, 0.00583715 ) ) ) );
		}
		vec2 vogelDiskSample( int sampleIndex, int samplesCount, float phi ) {
			const float goldenAngle = 2.399963229728653;
			float r = sqrt( ( float( sampleIndex ) + 0.5 ) / float( samplesCount ) );
			float theta = float( sampleIndex ) * goldenAngle + phi;
			return vec2( cos( theta ), sin( theta ) ) * r;
		}
	#endif
	#if defined( SHADOWMAP_TYPE_PCF )
		float getShadow( sampler2DShadow shadowMap, vec2 shadowMapSize, float shadowIntensity, float shadowBias, float shadowRadius, vec4 shadowCoord ) {
			float shadow = 1.0;
			shadowCoord.xyz /= shadowCoord.w;
			#ifdef USE_REVERSED_DEPTH_BUFFER
				shadowCoord.z -= shadowBias;
			#else
				shadowCoord.z += shadowBias;
			#endif
			bool inFrustum = shadowCoord.x >= 0.0 && shadowCoord.x <= 1.0 && shadowCoord.y >= 0.0 && shadowCoord.y <= 1.0;
			bool frustumTest = inFrustum && shadowCoord.z <= 1.0;
			if ( frustumTest ) {
				vec2 texelSize = vec2( 1.0 ) / shadowMapSize;
				vec2 radius = shadowRadius * texelSize;
				float phi = interleavedGradientNoise( gl_FragCoord.xy ) * PI2;
				shadow = (
					texture( shadowMap, vec3( shadowCoord.xy + vogelDiskSample( 0, 5, phi ) * radius, shadowCoord.z ) ) +
					texture( shadowMap, vec3( shadowCoord.xy + vogelDiskSample( 1, 5, phi ) * radius, shadowCoord.z ) ) +
					texture( shadowMap, vec3( shadowCoord.xy + vogelDiskSample( 2, 5, phi ) * radius, shadowCoord.z ) ) +
					texture( shadowMap, vec3( shadowCoord.xy + vogelDiskSample( 3, 5, phi ) * radius, shadowCoord.z ) ) +
					texture( shadowMap, vec3( shadowCoord.xy + vogelDiskSample( 4, 5, phi ) * radius, shadowCoord.z ) )
				) * 0.2;
			}
			return mix( 1.0, shadow, shadowIntensity );
		}
	#elif defined( SHADOWMAP_TYPE_VSM )
		float getShadow( sampler2D shadowMap, vec2 shadowMapSize, float shadowIntensity, float shadowBias, float shadowRadius, vec4 shadowCoord ) {
			float shadow = 1.0;
			shadowCoord.xyz /= shadowCoord.w;
			#ifdef USE_REVERSED_DEPTH_BUFFER
				shadowCoord.z -= shadowBias;
			#else
				shadowCoord.z += shadowBias;
			#endif
			bool inFrustum = shadowCoord.x >= 0.0 && shadowCoord.x <= 1.0 && shadowCoord.y >= 0.0 && shadowCoord.y <= 1.0;
			bool frustumTest = inFrustum && shadowCoord.z <= 1.0;
			if ( frustumTest ) {
				vec2 distribution = texture2D( shadowMap, shadowCoord.xy ).rg;
				float mean = distribution.x;
				float variance = distribution.y * distribution.y;
				#ifdef USE_REVERSED_DEPTH_BUFFER
					float hard_shadow = step( mean, shadowCoord.z );
				#else
					float hard_shadow = step( shadowCoord.z, mean );
				#endif
				
				if ( hard_shadow == 1.0 ) {
					shadow = 1.0;
				} else {
					variance = max( variance, 0.0000001 );
					float d = shadowCoord.z - mean;
					float p_max = variance / ( variance + d * d );
					p_max = clamp( ( p_max - 0.3 ) / 0.65, 0.0, 1.0 );
					shadow = max( hard_shadow, p_max );
				}
			}
			return mix( 1.0, shadow, shadowIntensity );
		}
	#else
		float getShadow( sampler2D shadowMap, vec2 shadowMapSize, float shadowIntensity, float shadowBias, float shadowRadius, vec4 shadowCoord ) {
			float shadow = 1.0;
			shadowCoord.xyz /= shadowCoord.w;
			#ifdef USE_REVERSED_DEPTH_BUFFER
				shadowCoord.z -= shadowBias;
			#else
				shadowCoord.z += shadowBias;
			#endif
			bool inFrustum = shadowCoord.x >= 0.0 && shadowCoord.x <= 1.0 && shadowCoord.y >= 0.0 && shadowCoord.y <= 1.0;
			bool frustumTest = inFrustum && shadowCoord.z <= 1.0;
			if ( frustumTest ) {
				float depth = texture2D( shadowMap, shadowCoord.xy ).r;
				#ifdef USE_REVERSED_DEPTH_BUFFER
					shadow = step( depth, shadowCoord.z );
				#else
					shadow = step( shadowCoord.z, depth );
				#endif
			}
			return mix( 1.0, shadow, shadowIntensity );
		}
	#endif
	#if NUM_SUN_LIGHT_SHADOWS > 0
		float getSunShadow(
			#if defined( SHADOWMAP_TYPE_PCF )
				sampler2DShadow shadowMap,
			#else
				sampler2D shadowMap,
			#endif
			SunLightShadow sunLightShadow,
			int shadowIndex
		) {
			vec4 shadowWorldPosition = vec4( vSunShadowWorldPosition.xyz + vSunShadowWorldNormal * sunLightShadow.shadowNormalBias, 1.0 );
			float viewDepth = vSunShadowWorldPosition.w;
			int cascadeOffset = shadowIndex * SUN_LIGHT_CASCADES;
			float shadow = 1.0;
			for ( int i = SUN_LIGHT_CASCADES - 1; i >= 0; i -- ) {
				vec4 cascade = sunShadowCascade[ cascadeOffset + i ];
				if ( viewDepth >= cascade.x && viewDepth < cascade.y ) {
					float cascadeShadow = getShadow(
						shadowMap,
						sunLightShadow.shadowMapSize,
						sunLightShadow.shadowIntensity,
						sunLightShadow.shadowBias,
						sunLightShadow.shadowRadius,
						sunShadowMatrix[ cascadeOffset + i ] * shadowWorldPosition
					);
					shadow = mix( cascadeShadow, shadow, smoothstep( cascade.z, cascade.y, viewDepth ) );
				}
			}
			return shadow;
		}
	#endif
	#if NUM_POINT_LIGHT_SHADOWS > 0
	#if defined( SHADOWMAP_TYPE_PCF )
	float getPointShadow( samplerCubeShadow shadowMap, vec2 shadowMapSize, float shadowIntensity, float shadowBias, float shadowRadius, vec4 shadowCoord, float shadowCameraNear, float shadowCameraFar ) {
		float shadow = 1.0;
		vec3 lightToPosition = shadowCoord.xyz;
		vec3 bd3D = normalize( lightToPosition );
		vec3 absVec = abs( lightToPosition );
		float viewSpaceZ = max( max( absVec.x, absVec.y ), absVec.z );
		if ( viewSpaceZ - shadowCameraFar <= 0.0 && viewSpaceZ - shadowCameraNear >= 0.0 ) {
			float lightDistance = length( lightToPosition );
			float depthRange = shadowCameraFar - shadowCameraNear;
			#ifdef USE_REVERSED_DEPTH_BUFFER
				float depthA = - shadowCameraNear / depthRange - shadowBias;
				float depthB = shadowCameraNear * shadowCameraFar / ( depthRange * lightDistance );
			#else
				float depthA = shadowCameraFar / depthRange + shadowBias;
				float depthB = - shadowCameraNear * shadowCameraFar / ( depthRange * lightDistance );
			#endif
			float texelSize = shadowRadius / shadowMapSize.x;
			vec3 absDir = abs( bd3D );
			vec3 tangent = absDir.x > absDir.z ? vec3( 0.0, 1.0, 0.0 ) : vec3( 1.0, 0.0, 0.0 );
			tangent = normalize( cross( bd3D, tangent ) );
			vec3 bitangent = cross( bd3D, tangent );
			float phi = interleavedGradientNoise( gl_FragCoord.xy ) * PI2;
			shadow = 0.0;
			for ( int i = 0; i < 5; i ++ ) {
				vec2 offset = vogelDiskSample( i, 5, phi );
				vec3 direction = bd3D + ( tangent * offset.x + bitangent * offset.y ) * texelSize;
				vec3 absDirection = abs( direction );
				float dp = depthA + depthB / max( max( absDirection.x, absDirection.y ), absDirection.z );
				shadow += texture( shadowMap, vec4( direction, dp ) );
			}
			shadow *= 0.2;
		}
		return mix( 1.0, shadow, shadowIntensity );
	}
	#elif defined( SHADOWMAP_TYPE_BASIC )
	float getPointShadow( samplerCube shadowMap, vec2 shadowMapSize, float shadowIntensity, float shadowBias, float shadowRadius, vec4 shadowCoord, float shadowCameraNear, float shadowCameraFar ) {
		float shadow = 1.0;
		vec3 lightToPosition = shadowCoord.xyz;
		vec3 absVec = abs( lightToPosition );
		float viewSpaceZ = max( max( absVec.x, absVec.y ), absVec.z );
		if ( viewSpaceZ - shadowCameraFar <= 0.0 && viewSpaceZ - shadowCameraNear >= 0.0 ) {
			float dp = ( shadowCameraFar * ( viewSpaceZ - shadowCameraNear ) ) / ( viewSpaceZ * ( shadowCameraFar - shadowCameraNear ) );
			dp += shadowBias;
			vec3 bd3D = normalize( lightToPosition );
			float depth = textureCube( shadowMap, bd3D ).r;
			#ifdef USE_REVERSED_DEPTH_BUFFER
				depth = 1.0 - depth;
			#endif
			shadow = step( dp, depth );
		}
		return mix( 1.0, shadow, shadowIntensity );
	}
	#endif
	#endif
#endif`,shadowmap_pars_vertex:`#if NUM_SPOT_LIGHT_COORDS > 0
	uniform mat4 spotLightMatrix[ NUM_SPOT_LIGHT_COORDS ];
	varying vec4 vSpotLightCoord[ NUM_SPOT_LIGHT_COORDS ];
#endif
#ifdef USE_SHADOWMAP
	#if NUM_SUN_LIGHT_SHADOWS > 0
		varying vec4 vSunShadowWorldPosition;
		varying vec3 vSunShadowWorldNormal;
	#endif
	#if NUM_DIR_LIGHT_SHADOWS > 0
		uniform mat4 directionalShadowMatrix[ NUM_DIR_LIGHT_SHADOWS ];
		varying vec4 vDirectionalShadowCoord[ NUM_DIR_LIGHT_SHADOWS ];
		struct DirectionalLightShadow {
			float shadowIntensity;
			float shadowBias;
			float shadowNormalBias;
			float shadowRadius;
			vec2 shadowMapSize;
		};
		uniform DirectionalLightShadow directionalLightShadows[ NUM_DIR_LIGHT_SHADOWS ];
	#endif
	#if NUM_SPOT_LIGHT_SHADOWS > 0
		struct SpotLightShadow {
			float shadowIntensity;
			float shadowBias;
			float shadowNormalBias;
			float shadowRadius;
			vec2 shadowMapSize;
		};
		uniform SpotLightShadow spotLightShadows[ NUM_SPOT_LIGHT_SHADOWS ];
	#endif
	#if NUM_POINT_LIGHT_SHADOWS > 0
		uniform mat4 pointShadowMatrix[ NUM_POINT_LIGHT_SHADOWS ];
		varying vec4 vPointShadowCoord[ NUM_POINT_LIGHT_SHADOWS ];
		struct PointLightShadow {
			float shadowIntensity;
			float shadowBias;
			float shadowNormalBias;
			float shadowRadius;
			vec2 shadowMapSize;
			float shadowCameraNear;
			float shadowCameraFar;
		};
		uniform PointLightShadow pointLightShadows[ NUM_POINT_LIGHT_SHADOWS ];
	#endif
#endif`,shadowmap_vertex:`#if ( defined( USE_SHADOWMAP ) && ( NUM_DIR_LIGHT_SHADOWS > 0 || NUM_SUN_LIGHT_SHADOWS > 0 || NUM_POINT_LIGHT_SHADOWS > 0 ) ) || ( NUM_SPOT_LIGHT_COORDS > 0 )
	#ifdef HAS_NORMAL
		vec3 shadowWorldNormal = transformNormalByInverseViewMatrix( transformedNormal, viewMatrix );
	#else
		vec3 shadowWorldNormal = vec3( 0.0 );
	#endif
	vec4 shadowWorldPosition;
#endif
#if defined( USE_SHADOWMAP )
	#if NUM_SUN_LIGHT_SHADOWS > 0
		vSunShadowWorldPosition = vec4( worldPosition.xyz, - mvPosition.z );
		vSunShadowWorldNormal = shadowWorldNormal;
	#endif
	#if NUM_DIR_LIGHT_SHADOWS > 0
		#pragma unroll_loop_start
		for ( int i = 0; i < NUM_DIR_LIGHT_SHADOWS; i ++ ) {
			shadowWorldPosition = worldPosition + vec4( shadowWorldNormal * directionalLightShadows[ i ].shadowNormalBias, 0 );
			vDirectionalShadowCoord[ i ] = directionalShadowMatrix[ i ] * shadowWorldPosition;
		}
		#pragma unroll_loop_end
	#endif
	#if NUM_POINT_LIGHT_SHADOWS > 0
		#pragma unroll_loop_start
		for ( int i = 0; i < NUM_POINT_LIGHT_SHADOWS; i ++ ) {
			shadowWorldPosition = worldPosition + vec4( shadowWorldNormal * pointLightShadows[ i ].shadowNormalBias, 0 );
			vPointShadowCoord[ i ] = pointShadowMatrix[ i ] * shadowWorldPosition;
		}
		#pragma unroll_loop_end
	#endif
#endif
#if NUM_SPOT_LIGHT_COORDS > 0
	#pragma unroll_loop_start
	for ( int i = 0; i < NUM_SPOT_LIGHT_COORDS; i ++ ) {
		shadowWorldPosition = worldPosition;
		#if ( defined( USE_SHADOWMAP ) && UNROLLED_LOOP_INDEX < NUM_SPOT_LIGHT_SHADOWS )
			shadowWorldPosition.xyz += shadowWorldNormal * spotLightShadows[ i ].shadowNormalBias;
		#endif
		vSpotLightCoord[ i ] = spotLightMatrix[ i ] * shadowWorldPosition;
	}
	#pragma unroll_loop_end
#endif`,shadowmask_pars_fragment:`float getShadowMask() {
	float shadow = 1.0;
	#ifdef USE_SHADOWMAP
	#if NUM_SUN_LIGHT_SHADOWS > 0
	SunLightShadow sunLight;
	#pragma unroll_loop_start
	for ( int i = 0; i < NUM_SUN_LIGHT_SHADOWS; i ++ ) {
		sunLight = sunLightShadows[ i ];
		shadow *= receiveShadow ? getSunShadow( sunShadowMap[ i ], sunLight, UNROLLED_LOOP_INDEX ) : 1.0;
	}
	#pragma unroll_loop_end
	#endif
	#if NUM_DIR_LIGHT_SHADOWS > 0
	DirectionalLightShadow directionalLight;
	#pragma unroll_loop_start
	for ( int i = 0; i < NUM_DIR_LIGHT_SHADOWS; i ++ ) {
		directionalLight = directionalLightShadows[ i ];
		shadow *= receiveShadow ? getShadow( directionalShadowMap[ i ], directionalLight.shadowMapSize, directionalLight.shadowIntensity, directionalLight.shadowBias, directionalLight.shadowRadius, vDirectionalShadowCoord[ i ] ) : 1.0;
	}
	#pragma unroll_loop_end
	#endif
	#if NUM_SPOT_LIGHT_SHADOWS > 0
	SpotLightShadow spotLight;
	#pragma unroll_loop_start
	for ( int i = 0; i < NUM_SPOT_LIGHT_SHADOWS; i ++ ) {
		spotLight = spotLightShadows[ i ];
		shadow *= receiveShadow ? getShadow( spotShadowMap[ i ], spotLight.shadowMapSize, spotLight.shadowIntensity, spotLight.shadowBias, spotLight.shadowRadius, vSpotLightCoord[ i ] ) : 1.0;
	}
	#pragma unroll_loop_end
	#endif
	#if NUM_POINT_LIGHT_SHADOWS > 0 && ( defined( SHADOWMAP_TYPE_PCF ) || defined( SHADOWMAP_TYPE_BASIC ) )
	PointLightShadow pointLight;
	#pragma unroll_loop_start
	for ( int i = 0; i < NUM_POINT_LIGHT_SHADOWS; i ++ ) {
		pointLight = pointLightShadows[ i ];
		shadow *= receiveShadow ? getPointShadow( pointShadowMap[ i ], pointLight.shadowMapSize, pointLight.shadowIntensity, pointLight.shadowBias, pointLight.shadowRadius, vPointShadowCoord[ i ], pointLight.shadowCameraNear, pointLight.shadowCameraFar ) : 1.0;
	}
	#pragma unroll_loop_end
	#endif
	#endif
	return shadow;
}`,skinbase_vertex:`#ifdef USE_SKINNING
	mat4 boneMatX = getBoneMatrix( skinIndex.x );
	mat4 boneMatY = getBoneMatrix( skinIndex.y );
	mat4 boneMatZ = getBoneMatrix( skinIndex.z );
	mat4 boneMatW = getBoneMatrix( skinIndex.w );
#endif`,skinning_pars_vertex:`#ifdef USE_SKINNING
	uniform mat4 bindMatrix;
	uniform mat4 bindMatrixInverse;
	uniform highp sampler2D boneTexture;
	mat4 getBoneMatrix( const in float i ) {
		int size = textureSize( boneTexture, 0 ).x;
		int j = int( i ) * 4;
		int x = j % size;
		int y = j / size;
		vec4 v1 = texelFetch( boneTexture, ivec2( x, y ), 0 );
		vec4 v2 = texelFetch( boneTexture, ivec2( x + 1, y ), 0 );
		vec4 v3 = texelFetch( boneTexture, ivec2( x + 2, y ), 0 );
		vec4 v4 = texelFetch( boneTexture, ivec2( x + 3, y ), 0 );
		return mat4( v1, v2, v3, v4 );
	}
#endif`,skinning_vertex:`#ifdef USE_SKINNING
	vec4 skinVertex = bindMatrix * vec4( transformed, 1.0 );
	vec4 skinned = vec4( 0.0 );
	skinned += boneMatX * skinVertex * skinWeight.x;
	skinned += boneMatY * skinVertex * skinWeight.y;
	skinned += boneMatZ * skinVertex * skinWeight.z;
	skinned += boneMatW * skinVertex * skinWeight.w;
	transformed = ( bindMatrixInverse * skinned ).xyz;
#endif`,skinnormal_vertex:`#ifdef USE_SKINNING
	mat4 skinMatrix = mat4( 0.0 );
	skinMatrix += skinWeight.x * boneMatX;
	skinMatrix += skinWeight.y * boneMatY;
	skinMatrix += skinWeight.z * boneMatZ;
	skinMatrix += skinWeight.w * boneMatW;
	skinMatrix = bindMatrixInverse * skinMatrix * bindMatrix;
	objectNormal = vec4( skinMatrix * vec4( objectNormal, 0.0 ) ).xyz;
	#ifdef USE_TANGENT
		objectTangent = vec4( skinMatrix * vec4( objectTangent, 0.0 ) ).xyz;
	#endif
#endif`,specularmap_fragment:`float specularStrength;
#ifdef USE_SPECULARMAP
	vec4 texelSpecular = texture2D( specularMap, vSpecularMapUv );
	specularStrength = texelSpecular.r;
#else
	specularStrength = 1.0;
#endif`,specularmap_pars_fragment:`#ifdef USE_SPECULARMAP
	uniform sampler2D specularMap;
#endif`,tonemapping_fragment:`#if defined( TONE_MAPPING )
	gl_FragColor.rgb = toneMapping( gl_FragColor.rgb );
#endif`,tonemapping_pars_fragment:`#ifndef saturate
#define saturate( a ) clamp( a, 0.0, 1.0 )
#endif
uniform float toneMappingExposure;
vec3 LinearToneMapping( vec3 color ) {
	return saturate( toneMappingExposure * color );
}
vec3 ReinhardToneMapping( vec3 color ) {
	color *= toneMappingExposure;
	return saturate( color / ( vec3( 1.0 ) + color ) );
}
vec3 CineonToneMapping( vec3 color ) {
	color *= toneMappingExposure;
	color = max( vec3( 0.0 ), color - 0.004 );
	return pow( ( color * ( 6.2 * color + 0.5 ) ) / ( color * ( 6.2 * color + 1.7 ) + 0.06 ), vec3( 2.2 ) );
}
vec3 RRTAndODTFit( vec3 v ) {
	vec3 a = v * ( v + 0.0245786 ) - 0.000090537;
	vec3 b = v * ( 0.983729 * v + 0.4329510 ) + 0.238081;
	return a / b;
}
vec3 ACESFilmicToneMapping( vec3 color ) {
	const mat3 ACESInputMat = mat3(
		vec3( 0.59719, 0.07600, 0.02840 ),		vec3( 0.35458, 0.90834, 0.13383 ),
		vec3( 0.04823, 0.01566, 0.83777 )
	);
	const mat3 ACESOutputMat = mat3(
		vec3(  1.60475, -0.10208, -0.00327 ),		vec3( -0.53108,  1.10813, -0.07276 ),
		vec3( -0.07367, -0.00605,  1.07602 )
	);
	color *= toneMappingExposure / 0.6;
	color = ACESInputMat * color;
	color = RRTAndODTFit( color );
	color = ACESOutputMat * color;
	return saturate( color );
}
const mat3 LINEAR_REC2020_TO_LINEAR_SRGB = mat3(
	vec3( 1.6605, - 0.1246, - 0.0182 ),
	vec3( - 0.5876, 1.1329, - 0.1006 ),
	vec3( - 0.0728, - 0.0083, 1.1187 )
);
const mat3 LINEAR_SRGB_TO_LINEAR_REC2020 = mat3(
	vec3( 0.6274, 0.0691, 0.0164 ),
	vec3( 0.3293, 0.9195, 0.0880 ),
	vec3( 0.0433, 0.0113, 0.8956 )
);
vec3 agxDefaultContrastApprox( vec3 x ) {
	vec3 x2 = x * x;
	vec3 x4 = x2 * x2;
	return + 15.5 * x4 * x2
		- 40.14 * x4 * x
		+ 31.96 * x4
		- 6.868 * x2 * x
		+ 0.4298 * x2
		+ 0.1191 * x
		- 0.00232;
}
vec3 AgXToneMapping( vec3 color ) {
	const mat3 AgXInsetMatrix = mat3(
		vec3( 0.856627153315983, 0.137318972929847, 0.11189821299995 ),
		vec3( 0.0951212405381588, 0.761241990602591, 0.0767994186031903 ),
		vec3( 0.0482516061458583, 0.101439036467562, 0.811302368396859 )
	);
	const mat3 AgXOutsetMatrix = mat3(
		vec3( 1.1271005818144368, - 0.1413297634984383, - 0.14132976349843826 ),
		vec3( - 0.11060664309660323, 1.157823702216272, - 0.11060664309660294 ),
		vec3( - 0.016493938717834573, - 0.016493938717834257, 1.2519364065950405 )
	);
	const float AgxMinEv = - 12.47393;	const float AgxMaxEv = 4.026069;
	color *= toneMappingExposure;
	color = LINEAR_SRGB_TO_LINEAR_REC2020 * color;
	color = AgXInsetMatrix * color;
	color = max( color, 1e-10 );	color = log2( color );
	color = ( color - AgxMinEv ) / ( AgxMaxEv - AgxMinEv );
	color = clamp( color, 0.0, 1.0 );
	color = agxDefaultContrastApprox( color );
	color = AgXOutsetMatrix * color;
	color = pow( max( vec3( 0.0 ), color ), vec3( 2.2 ) );
	color = LINEAR_REC2020_TO_LINEAR_SRGB * color;
	color = clamp( color, 0.0, 1.0 );
	return color;
}
vec3 NeutralToneMapping( vec3 color ) {
	const float StartCompression = 0.8 - 0.04;
	const float Desaturation = 0.15;
	color *= toneMappingExposure;
	float x = min( color.r, min( color.g, color.b ) );
	float offset = x < 0.08 ? x - 6.25 * x * x : 0.04;
	color -= offset;
	float peak = max( color.r, max( color.g, color.b ) );
	if ( peak < StartCompression ) return color;
	float d = 1. - StartCompression;
	float newPeak = 1. - d * d / ( peak + d - StartCompression );
	color *= newPeak / peak;
	float g = 1. - 1. / ( Desaturation * ( peak - newPeak ) + 1. );
	return mix( color, vec3( newPeak ), g );
}
vec3 CustomToneMapping( vec3 color ) { return color; }`,transmission_fragment:`#ifdef USE_TRANSMISSION
	material.transmission = transmission;
	material.transmissionAlpha = 1.0;
	material.thickness = thickness;
	material.attenuationDistance = attenuationDistance;
	material.attenuationColor = attenuationColor;
	#ifdef USE_TRANSMISSIONMAP
		material.transmission *= texture2D( transmissionMap, vTransmissionMapUv ).r;
	#endif
	#ifdef USE_THICKNESSMAP
		material.thickness *= texture2D( thicknessMap, vThicknessMapUv ).g;
	#endif
	vec3 pos = vWorldPosition;
	vec3 v = normalize( cameraPosition - pos );
	vec3 n = transformNormalByInverseViewMatrix( normal, viewMatrix );
	vec4 transmitted = getIBLVolumeRefraction(
		n, v, material.roughness, material.diffuseContribution, material.specularColorBlended, material.specularF90,
		pos, modelMatrix, viewMatrix, projectionMatrix, material.dispersion, material.ior, material.thickness,
		material.attenuationColor, material.attenuationDistance );
	material.transmissionAlpha = mix( material.transmissionAlpha, transmitted.a, material.transmission );
	totalDiffuse = mix( totalDiffuse, transmitted.rgb, material.transmission );
#endif`,transmission_pars_fragment:`#ifdef USE_TRANSMISSION
	uniform float transmission;
	uniform float thickness;
	uniform float attenuationDistance;
	uniform vec3 attenuationColor;
	#ifdef USE_TRANSMISSIONMAP
		uniform sampler2D transmissionMap;
	#endif
	#ifdef USE_THICKNESSMAP
		uniform sampler2D thicknessMap;
	#endif
	uniform vec2 transmissionSamplerSize;
	uniform sampler2D transmissionSamplerMap;
	uniform mat4 modelMatrix;
	uniform mat4 projectionMatrix;
	varying vec3 vWorldPosition;
	float w0( float a ) {
		return ( 1.0 / 6.0 ) * ( a * ( a * ( - a + 3.0 ) - 3.0 ) + 1.0 );
	}
	float w1( float a ) {
		return ( 1.0 / 6.0 ) * ( a *  a * ( 3.0 * a - 6.0 ) + 4.0 );
	}
	float w2( float a ){
		return ( 1.0 / 6.0 ) * ( a * ( a * ( - 3.0 * a + 3.0 ) + 3.0 ) + 1.0 );
	}
	float w3( float a ) {
		return ( 1.0 / 6.0 ) * ( a * a * a );
	}
	float g0( float a ) {
		return w0( a ) + w1( a );
	}
	float g1( float a ) {
		return w2( a ) + w3( a );
	}
	float h0( float a ) {
		return - 1.0 + w1( a ) / ( w0( a ) + w1( a ) );
	}
	float h1( float a ) {
		return 1.0 + w3( a ) / ( w2( a ) + w3( a ) );
	}
	vec4 bicubic( sampler2D tex, vec2 uv, vec4 texelSize, float lod ) {
		uv = uv * texelSize.zw + 0.5;
		vec2 iuv = floor( uv );
		vec2 fuv = fract( uv );
		float g0x = g0( fuv.x );
		float g1x = g1( fuv.x );
		float h0x = h0( fuv.x );
		float h1x = h1( fuv.x );
		float h0y = h0( fuv.y );
		float h1y = h1( fuv.y );
		vec2 p0 = ( vec2( iuv.x + h0x, iuv.y + h0y ) - 0.5 ) * texelSize.xy;
		vec2 p1 = ( vec2( iuv.x + h1x, iuv.y + h0y ) - 0.5 ) * texelSize.xy;
		vec2 p2 = ( vec2( iuv.x + h0x, iuv.y + h1y ) - 0.5 ) * texelSize.xy;
		vec2 p3 = ( vec2( iuv.x + h1x, iuv.y + h1y ) - 0.5 ) * texelSize.xy;
		return g0( fuv.y ) * ( g0x * textureLod( tex, p0, lod ) + g1x * textureLod( tex, p1, lod ) ) +
			g1( fuv.y ) * ( g0x * textureLod( tex, p2, lod ) + g1x * textureLod( tex, p3, lod ) );
	}
	vec4 textureBicubic( sampler2D sampler, vec2 uv, float lod ) {
		vec2 fLodSize = vec2( textureSize( sampler, int( lod ) ) );
		vec2 cLodSize = vec2( textureSize( sampler, int( lod + 1.0 ) ) );
		vec2 fLodSizeInv = 1.0 / fLodSize;
		vec2 cLodSizeInv = 1.0 / cLodSize;
		vec4 fSample = bicubic( sampler, uv, vec4( fLodSizeInv, fLodSize ), floor( lod ) );
		vec4 cSample = bicubic( sampler, uv, vec4( cLodSizeInv, cLodSize ), ceil( lod ) );
		return mix( fSample, cSample, fract( lod ) );
	}
	vec3 getVolumeTransmissionRay( const in vec3 n, const in vec3 v, const in float thickness, const in float ior, const in mat4 modelMatrix ) {
		vec3 refractionVector = refract( - v, normalize( n ), 1.0 / ior );
		vec3 modelScale;
		modelScale.x = length( vec3( modelMatrix[ 0 ].xyz ) );
		modelScale.y = length( vec3( modelMatrix[ 1 ].xyz ) );
		modelScale.z = length( vec3( modelMatrix[ 2 ].xyz ) );
		return normalize( refractionVector ) * thickness * modelScale;
	}
	float applyIorToRoughness( const in float roughness, const in float ior ) {
		return roughness * clamp( ior * 2.0 - 2.0, 0.0, 1.0 );
	}
	vec4 getTransmissionSample( const in vec2 fragCoord, const in float roughness, const in float ior ) {
		float lod = log2( transmissionSamplerSize.x ) * applyIorToRoughness( roughness, ior );
		return textureBicubic( transmissionSamplerMap, fragCoord.xy, lod );
	}
	vec3 volumeAttenuation( const in float transmissionDistance, const in vec3 attenuationColor, const in float attenuationDistance ) {
		if ( isinf( attenuationDistance ) ) {
			return vec3( 1.0 );
		} else {
			vec3 attenuationCoefficient = -log( attenuationColor ) / attenuationDistance;
			vec3 transmittance = exp( - attenuationCoefficient * transmissionDistance );			return transmittance;
		}
	}
	vec4 getIBLVolumeRefraction( const in vec3 n, const in vec3 v, const in float roughness, const in vec3 diffuseColor,
		const in vec3 specularColor, const in float specularF90, const in vec3 position, const in mat4 modelMatrix,
		const in mat4 viewMatrix, const in mat4 projMatrix, const in float dispersion, const in float ior, const in float thickness,
		const in vec3 attenuationColor, const in float attenuationDistance ) {
		vec4 transmittedLight;
		vec3 transmittance;
		#ifdef USE_DISPERSION
			float halfSpread = ( ior - 1.0 ) * 0.025 * dispersion;
			vec3 iors = vec3( ior - halfSpread, ior, ior + halfSpread );
			for ( int i = 0; i < 3; i ++ ) {
				vec3 transmissionRay = getVolumeTransmissionRay( n, v, thickness, iors[ i ], modelMatrix );
				vec3 refractedRayExit = position + transmissionRay;
				vec4 ndcPos = projMatrix * viewMatrix * vec4( refractedRayExit, 1.0 );
				vec2 refractionCoords = ndcPos.xy / ndcPos.w;
				refractionCoords += 1.0;
				refractionCoords /= 2.0;
				vec4 transmissionSample = getTransmissionSample( refractionCoords, roughness, iors[ i ] );
				transmittedLight[ i ] = transmissionSample[ i ];
				transmittedLight.a += transmissionSample.a;
				transmittance[ i ] = diffuseColor[ i ] * volumeAttenuation( length( transmissionRay ), attenuationColor, attenuationDistance )[ i ];
			}
			transmittedLight.a /= 3.0;
		#else
			vec3 transmissionRay = getVolumeTransmissionRay( n, v, thickness, ior, modelMatrix );
			vec3 refractedRayExit = position + transmissionRay;
			vec4 ndcPos = projMatrix * viewMatrix * vec4( refractedRayExit, 1.0 );
			vec2 refractionCoords = ndcPos.xy / ndcPos.w;
			refractionCoords += 1.0;
			refractionCoords /= 2.0;
			transmittedLight = getTransmissionSample( refractionCoords, roughness, ior );
			transmittance = diffuseColor * volumeAttenuation( length( transmissionRay ), attenuationColor, attenuationDistance );
		#endif
		vec3 attenuatedColor = transmittance * transmittedLight.rgb;
		vec3 F = EnvironmentBRDF( n, v, specularColor, specularF90, roughness );
		float transmittanceFactor = ( transmittance.r + transmittance.g + transmittance.b ) / 3.0;
		return vec4( ( 1.0 - F ) * attenuatedColor, 1.0 - ( 1.0 - transmittedLight.a ) * transmittanceFactor );
	}
#endif`,uv_pars_fragment:`#if defined( USE_UV ) || defined( USE_ANISOTROPY )
	varying vec2 vUv;
#endif
#ifdef USE_MAP
	varying vec2 vMapUv;
#endif
#ifdef USE_ALPHAMAP
	varying vec2 vAlphaMapUv;
#endif
#ifdef USE_LIGHTMAP
	varying vec2 vLightMapUv;
#endif
#ifdef USE_AOMAP
	varying vec2 vAoMapUv;
#endif
#ifdef USE_BUMPMAP
	varying vec2 vBumpMapUv;
#endif
#ifdef USE_NORMALMAP
	varying vec2 vNormalMapUv;
#endif
#ifdef USE_EMISSIVEMAP
	varying vec2 vEmissiveMapUv;
#endif
#ifdef USE_METALNESSMAP
	varying vec2 vMetalnessMapUv;
#endif
#ifdef USE_ROUGHNESSMAP
	varying vec2 vRoughnessMapUv;
#endif
#ifdef USE_DIFFUSE_ROUGHNESSMAP
	varying vec2 vDiffuseRoughnessMapUv;
#endif
#ifdef USE_ANISOTROPYMAP
	varying vec2 vAnisotropyMapUv;
#endif
#ifdef USE_CLEARCOATMAP
	varying vec2 vClearcoatMapUv;
#endif
#ifdef USE_CLEARCOAT_NORMALMAP
	varying vec2 vClearcoatNormalMapUv;
#endif
#ifdef USE_CLEARCOAT_ROUGHNESSMAP
	varying vec2 vClearcoatRoughnessMapUv;
#endif
#ifdef USE_IRIDESCENCEMAP
	varying vec2 vIridescenceMapUv;
#endif
#ifdef USE_IRIDESCENCE_THICKNESSMAP
	varying vec2 vIridescenceThicknessMapUv;
#endif
#ifdef USE_SHEEN_COLORMAP
	varying vec2 vSheenColorMapUv;
#endif
#ifdef USE_SHEEN_ROUGHNESSMAP
	varying vec2 vSheenRoughnessMapUv;
#endif
#ifdef USE_SPECULARMAP
	varying vec2 vSpecularMapUv;
#endif
#ifdef USE_SPECULAR_COLORMAP
	varying vec2 vSpecularColorMapUv;
#endif
#ifdef USE_SPECULAR_INTENSITYMAP
	varying vec2 vSpecularIntensityMapUv;
#endif
#ifdef USE_TRANSMISSIONMAP
	uniform mat3 transmissionMapTransform;
	varying vec2 vTransmissionMapUv;
#endif
#ifdef USE_THICKNESSMAP
	uniform mat3 thicknessMapTransform;
	varying vec2 vThicknessMapUv;
#endif`,uv_pars_vertex:`#if defined( USE_UV ) || defined( USE_ANISOTROPY )
	varying vec2 vUv;
#endif
#ifdef USE_MAP
	uniform mat3 mapTransform;
	varying vec2 vMapUv;
#endif
#ifdef USE_ALPHAMAP
	uniform mat3 alphaMapTransform;
	varying vec2 vAlphaMapUv;
#endif
#ifdef USE_LIGHTMAP
	uniform mat3 lightMapTransform;
	varying vec2 vLightMapUv;
#endif
#ifdef USE_AOMAP
	uniform mat3 aoMapTransform;
	varying vec2 vAoMapUv;
#endif
#ifdef USE_BUMPMAP
	uniform mat3 bumpMapTransform;
	varying vec2 vBumpMapUv;
#endif
#ifdef USE_NORMALMAP
	uniform mat3 normalMapTransform;
	varying vec2 vNormalMapUv;
#endif
#ifdef USE_DISPLACEMENTMAP
	uniform mat3 displacementMapTransform;
	varying vec2 vDisplacementMapUv;
#endif
#ifdef USE_EMISSIVEMAP
	uniform mat3 emissiveMapTransform;
	varying vec2 vEmissiveMapUv;
#endif
#ifdef USE_METALNESSMAP
	uniform mat3 metalnessMapTransform;
	varying vec2 vMetalnessMapUv;
#endif
#ifdef USE_ROUGHNESSMAP
	uniform mat3 roughnessMapTransform;
	varying vec2 vRoughnessMapUv;
#endif
#ifdef USE_DIFFUSE_ROUGHNESSMAP
	uniform mat3 diffuseRoughnessMapTransform;
	varying vec2 vDiffuseRoughnessMapUv;
#endif
#ifdef USE_ANISOTROPYMAP
	uniform mat3 anisotropyMapTransform;
	varying vec2 vAnisotropyMapUv;
#endif
#ifdef USE_CLEARCOATMAP
	uniform mat3 clearcoatMapTransform;
	varying vec2 vClearcoatMapUv;
#endif
#ifdef USE_CLEARCOAT_NORMALMAP
	uniform mat3 clearcoatNormalMapTransform;
	varying vec2 vClearcoatNormalMapUv;
#endif
#ifdef USE_CLEARCOAT_ROUGHNESSMAP
	uniform mat3 clearcoatRoughnessMapTransform;
	varying vec2 vClearcoatRoughnessMapUv;
#endif
#ifdef USE_SHEEN_COLORMAP
	uniform mat3 sheenColorMapTransform;
	varying vec2 vSheenColorMapUv;
#endif
#ifdef USE_SHEEN_ROUGHNESSMAP
	uniform mat3 sheenRoughnessMapTransform;
	varying vec2 vSheenRoughnessMapUv;
#endif
#ifdef USE_IRIDESCENCEMAP
	uniform mat3 iridescenceMapTransform;
	varying vec2 vIridescenceMapUv;
#endif
#ifdef USE_IRIDESCENCE_THICKNESSMAP
	uniform mat3 iridescenceThicknessMapTransform;
	varying vec2 vIridescenceThicknessMapUv;
#endif
#ifdef USE_SPECULARMAP
	uniform mat3 specularMapTransform;
	varying vec2 vSpecularMapUv;
#endif
#ifdef USE_SPECULAR_COLORMAP
	uniform mat3 specularColorMapTransform;
	varying vec2 vSpecularColorMapUv;
#endif
#ifdef USE_SPECULAR_INTENSITYMAP
	uniform mat3 specularIntensityMapTransform;
	varying vec2 vSpecularIntensityMapUv;
#endif
#ifdef USE_TRANSMISSIONMAP
	uniform mat3 transmissionMapTransform;
	varying vec2 vTransmissionMapUv;
#endif
#ifdef USE_THICKNESSMAP
	uniform mat3 thicknessMapTransform;
	varying vec2 vThicknessMapUv;
#endif`,uv_vertex:`#if defined( USE_UV ) || defined( USE_ANISOTROPY )
	vUv = vec3( uv, 1 ).xy;
#endif
#ifdef USE_MAP
	vMapUv = ( mapTransform * vec3( MAP_UV, 1 ) ).xy;
#endif
#ifdef USE_ALPHAMAP
	vAlphaMapUv = ( alphaMapTransform * vec3( ALPHAMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_LIGHTMAP
	vLightMapUv = ( lightMapTransform * vec3( LIGHTMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_AOMAP
	vAoMapUv = ( aoMapTransform * vec3( AOMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_BUMPMAP
	vBumpMapUv = ( bumpMapTransform * vec3( BUMPMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_NORMALMAP
	vNormalMapUv = ( normalMapTransform * vec3( NORMALMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_DISPLACEMENTMAP
	vDisplacementMapUv = ( displacementMapTransform * vec3( DISPLACEMENTMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_EMISSIVEMAP
	vEmissiveMapUv = ( emissiveMapTransform * vec3( EMISSIVEMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_METALNESSMAP
	vMetalnessMapUv = ( metalnessMapTransform * vec3( METALNESSMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_ROUGHNESSMAP
	vRoughnessMapUv = ( roughnessMapTransform * vec3( ROUGHNESSMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_DIFFUSE_ROUGHNESSMAP
	vDiffuseRoughnessMapUv = ( diffuseRoughnessMapTransform * vec3( DIFFUSE_ROUGHNESSMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_ANISOTROPYMAP
	vAnisotropyMapUv = ( anisotropyMapTransform * vec3( ANISOTROPYMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_CLEARCOATMAP
	vClearcoatMapUv = ( clearcoatMapTransform * vec3( CLEARCOATMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_CLEARCOAT_NORMALMAP
	vClearcoatNormalMapUv = ( clearcoatNormalMapTransform * vec3( CLEARCOAT_NORMALMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_CLEARCOAT_ROUGHNESSMAP
	vClearcoatRoughnessMapUv = ( clearcoatRoughnessMapTransform * vec3( CLEARCOAT_ROUGHNESSMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_IRIDESCENCEMAP
	vIridescenceMapUv = ( iridescenceMapTransform * vec3( IRIDESCENCEMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_IRIDESCENCE_THICKNESSMAP
	vIridescenceThicknessMapUv = ( iridescenceThicknessMapTransform * vec3( IRIDESCENCE_THICKNESSMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_SHEEN_COLORMAP
	vSheenColorMapUv = ( sheenColorMapTransform * vec3( SHEEN_COLORMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_SHEEN_ROUGHNESSMAP
	vSheenRoughnessMapUv = ( sheenRoughnessMapTransform * vec3( SHEEN_ROUGHNESSMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_SPECULARMAP
	vSpecularMapUv = ( specularMapTransform * vec3( SPECULARMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_SPECULAR_COLORMAP
	vSpecularColorMapUv = ( specularColorMapTransform * vec3( SPECULAR_COLORMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_SPECULAR_INTENSITYMAP
	vSpecularIntensityMapUv = ( specularIntensityMapTransform * vec3( SPECULAR_INTENSITYMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_TRANSMISSIONMAP
	vTransmissionMapUv = ( transmissionMapTransform * vec3( TRANSMISSIONMAP_UV, 1 ) ).xy;
#endif
#ifdef USE_THICKNESSMAP
	vThicknessMapUv = ( thicknessMapTransform * vec3( THICKNESSMAP_UV, 1 ) ).xy;
#endif`,worldpos_vertex:`#if defined( USE_ENVMAP ) || defined( DISTANCE ) || defined ( USE_SHADOWMAP ) || defined ( USE_TRANSMISSION ) || NUM_SPOT_LIGHT_COORDS > 0
	vec4 worldPosition = vec4( transformed, 1.0 );
	#ifdef USE_BATCHING
		worldPosition = batchingMatrix * worldPosition;
	#endif
	#ifdef USE_INSTANCING
		worldPosition = instanceMatrix * worldPosition;
	#endif
	worldPosition = modelMatrix * worldPosition;
#endif`,background_vert:`varying vec2 vUv;
uniform mat3 uvTransform;
void main() {
	vUv = ( uvTransform * vec3( uv, 1 ) ).xy;
	gl_Position = vec4( position.xy, 1.0, 1.0 );
}`,background_frag:`uniform sampler2D t2D;
uniform float backgroundIntensity;
varying vec2 vUv;
void main() {
	vec4 texColor = texture2D( t2D, vUv );
	#ifdef DECODE_VIDEO_TEXTURE
		texColor = vec4( mix( pow( texColor.rgb * 0.9478672986 + vec3( 0.0521327014 ), vec3( 2.4 ) ), texColor.rgb * 0.0773993808, vec3( lessThanEqual( texColor.rgb, vec3( 0.04045 ) ) ) ), texColor.w );
	#endif
	texColor.rgb *= backgroundIntensity;
	gl_FragColor = texColor;
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
}`,backgroundCube_vert:`varying vec3 vWorldDirection;
#include <common>
void main() {
	vWorldDirection = transformDirection( position, modelMatrix );
	#include <begin_vertex>
	#include <project_vertex>
	gl_Position.z = gl_Position.w;
}`,backgroundCube_frag:`uniform float backgroundBlurriness;
uniform float backgroundIntensity;
uniform mat3 backgroundRotation;
varying vec3 vWorldDirection;
#include <envmap_common_pars_fragment>
void main() {
	#ifdef ENVMAP_TYPE_PMREM
		vec4 texColor = textureLod( envMap, backgroundRotation * vWorldDirection, roughnessToMip( backgroundBlurriness ) );
	#else
		vec4 texColor = textureCube( envMap, backgroundRotation * vWorldDirection );
	#endif
	texColor.rgb *= backgroundIntensity;
	gl_FragColor = texColor;
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
}`,cube_vert:`varying vec3 vWorldDirection;
#include <common>
void main() {
	vWorldDirection = transformDirection( position, modelMatrix );
	#include <begin_vertex>
	#include <project_vertex>
	gl_Position.z = gl_Position.w;
}`,cube_frag:`uniform samplerCube tCube;
uniform float tFlip;
uniform float opacity;
varying vec3 vWorldDirection;
void main() {
	vec4 texColor = textureCube( tCube, vec3( tFlip * vWorldDirection.x, vWorldDirection.yz ) );
	gl_FragColor = texColor;
	gl_FragColor.a *= opacity;
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
}`,depth_vert:`#include <common>
#include <batching_pars_vertex>
#include <uv_pars_vertex>
#include <displacementmap_pars_vertex>
#include <morphtarget_pars_vertex>
#include <skinning_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>
varying vec2 vHighPrecisionZW;
void main() {
	#include <uv_vertex>
	#include <batching_vertex>
	#include <skinbase_vertex>
	#include <morphinstance_vertex>
	#ifdef USE_DISPLACEMENTMAP
		#include <beginnormal_vertex>
		#include <morphnormal_vertex>
		#include <skinnormal_vertex>
	#endif
	#include <begin_vertex>
	#include <morphtarget_vertex>
	#include <skinning_vertex>
	#include <displacementmap_vertex>
	#include <project_vertex>
	#include <logdepthbuf_vertex>
	#include <clipping_planes_vertex>
	vHighPrecisionZW = gl_Position.zw;
}`,depth_frag:`#if DEPTH_PACKING == 3200
	uniform float opacity;
#endif
#include <common>
#include <packing>
#include <uv_pars_fragment>
#include <map_pars_fragment>
#include <alphamap_pars_fragment>
#include <alphatest_pars_fragment>
#include <alphahash_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>
varying vec2 vHighPrecisionZW;
void main() {
	vec4 diffuseColor = vec4( 1.0 );
	#include <clipping_planes_fragment>
	#if DEPTH_PACKING == 3200
		diffuseColor.a = opacity;
	#endif
	#include <map_fragment>
	#include <alphamap_fragment>
	#include <alphatest_fragment>
	#include <alphahash_fragment>
	#include <logdepthbuf_fragment>
	#ifdef USE_REVERSED_DEPTH_BUFFER
		float fragCoordZ = vHighPrecisionZW[ 0 ] / vHighPrecisionZW[ 1 ];
	#else
		float fragCoordZ = 0.5 * vHighPrecisionZW[ 0 ] / vHighPrecisionZW[ 1 ] + 0.5;
	#endif
	#if DEPTH_PACKING == 3200
		gl_FragColor = vec4( vec3( 1.0 - fragCoordZ ), opacity );
	#elif DEPTH_PACKING == 3201
		gl_FragColor = packDepthToRGBA( fragCoordZ );
	#elif DEPTH_PACKING == 3202
		gl_FragColor = vec4( packDepthToRGB( fragCoordZ ), 1.0 );
	#elif DEPTH_PACKING == 3203
		gl_FragColor = vec4( packDepthToRG( fragCoordZ ), 0.0, 1.0 );
	#endif
}`,distance_vert:`#define DISTANCE
varying vec3 vWorldPosition;
#include <common>
#include <batching_pars_vertex>
#include <uv_pars_vertex>
#include <displacementmap_pars_vertex>
#include <morphtarget_pars_vertex>
#include <skinning_pars_vertex>
#include <clipping_planes_pars_vertex>
void main() {
	#include <uv_vertex>
	#include <batching_vertex>
	#include <skinbase_vertex>
	#include <morphinstance_vertex>
	#ifdef USE_DISPLACEMENTMAP
		#include <beginnormal_vertex>
		#include <morphnormal_vertex>
		#include <skinnormal_vertex>
	#endif
	#include <begin_vertex>
	#include <morphtarget_vertex>
	#include <skinning_vertex>
	#include <displacementmap_vertex>
	#include <project_vertex>
	#include <worldpos_vertex>
	#include <clipping_planes_vertex>
	vWorldPosition = worldPosition.xyz;
}`,distance_frag:`#define DISTANCE
uniform vec3 referencePosition;
uniform float nearDistance;
uniform float farDistance;
varying vec3 vWorldPosition;
#include <common>
#include <uv_pars_fragment>
#include <map_pars_fragment>
#include <alphamap_pars_fragment>
#include <alphatest_pars_fragment>
#include <alphahash_pars_fragment>
#include <clipping_planes_pars_fragment>
void main() {
	vec4 diffuseColor = vec4( 1.0 );
	#include <clipping_planes_fragment>
	#include <map_fragment>
	#include <alphamap_fragment>
	#include <alphatest_fragment>
	#include <alphahash_fragment>
	float dist = length( vWorldPosition - referencePosition );
	dist = ( dist - nearDistance ) / ( farDistance - nearDistance );
	dist = saturate( dist );
	gl_FragColor = vec4( dist, 0.0, 0.0, 1.0 );
}`,equirect_vert:`varying vec3 vWorldDirection;
#include <common>
void main() {
	vWorldDirection = transformDirection( position, modelMatrix );
	#include <begin_vertex>
	#include <project_vertex>
}`,equirect_frag:`uniform sampler2D tEquirect;
varying vec3 vWorldDirection;
#include <common>
void main() {
	vec3 direction = normalize( vWorldDirection );
	vec2 sampleUV = equirectUv( direction );
	gl_FragColor = texture2D( tEquirect, sampleUV );
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
}`,linedashed_vert:`uniform float scale;
attribute float lineDistance;
varying float vLineDistance;
#include <common>
#include <uv_pars_vertex>
#include <color_pars_vertex>
#include <fog_pars_vertex>
#include <morphtarget_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>
void main() {
	vLineDistance = scale * lineDistance;
	#include <uv_vertex>
	#include <color_vertex>
	#include <morphinstance_vertex>
	#include <morphcolor_vertex>
	#include <begin_vertex>
	#include <morphtarget_vertex>
	#include <project_vertex>
	#include <logdepthbuf_vertex>
	#include <clipping_planes_vertex>
	#include <fog_vertex>
}`,linedashed_frag:`uniform vec3 diffuse;
uniform float opacity;
uniform float dashSize;
uniform float totalSize;
varying float vLineDistance;
#include <common>
#include <color_pars_fragment>
#include <uv_pars_fragment>
#include <map_pars_fragment>
#include <fog_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>
void main() {
	vec4 diffuseColor = vec4( diffuse, opacity );
	#include <clipping_planes_fragment>
	if ( mod( vLineDistance, totalSize ) > dashSize ) {
		discard;
	}
	vec3 outgoingLight = vec3( 0.0 );
	#include <logdepthbuf_fragment>
	#include <map_fragment>
	#include <color_fragment>
	outgoingLight = diffuseColor.rgb;
	#include <opaque_fragment>
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
	#include <fog_fragment>
	#include <premultiplied_alpha_fragment>
}`,meshbasic_vert:`#include <common>
#include <batching_pars_vertex>
#include <uv_pars_vertex>
#include <envmap_pars_vertex>
#include <color_pars_vertex>
#include <fog_pars_vertex>
#include <morphtarget_pars_vertex>
#include <skinning_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>
void main() {
	#include <uv_vertex>
	#include <color_vertex>
	#include <morphinstance_vertex>
	#include <morphcolor_vertex>
	#include <batching_vertex>
	#if defined ( USE_ENVMAP ) || defined ( USE_SKINNING )
		#include <beginnormal_vertex>
		#include <morphnormal_vertex>
		#include <skinbase_vertex>
		#include <skinnormal_vertex>
		#include <defaultnormal_vertex>
	#endif
	#include <begin_vertex>
	#include <morphtarget_vertex>
	#include <skinning_vertex>
	#include <project_vertex>
	#include <logdepthbuf_vertex>
	#include <clipping_planes_vertex>
	#include <worldpos_vertex>
	#include <envmap_vertex>
	#include <fog_vertex>
}`,meshbasic_frag:`uniform vec3 diffuse;
uniform float opacity;
#ifndef FLAT_SHADED
	varying vec3 vNormal;
#endif
#include <common>
#include <dithering_pars_fragment>
#include <color_pars_fragment>
#include <uv_pars_fragment>
#include <map_pars_fragment>
#include <alphamap_pars_fragment>
#include <alphatest_pars_fragment>
#include <alphahash_pars_fragment>
#include <aomap_pars_fragment>
#include <lightmap_pars_fragment>
#include <envmap_common_pars_fragment>
#include <envmap_pars_fragment>
#include <fog_pars_fragment>
#include <specularmap_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>
void main() {
	vec4 diffuseColor = vec4( diffuse, opacity );
	#include <clipping_planes_fragment>
	#include <logdepthbuf_fragment>
	#include <map_fragment>
	#include <color_fragment>
	#include <alphamap_fragment>
	#include <alphatest_fragment>
	#include <alphahash_fragment>
	#include <specularmap_fragment>
	ReflectedLight reflectedLight = ReflectedLight( vec3( 0.0 ), vec3( 0.0 ), vec3( 0.0 ), vec3( 0.0 ) );
	#ifdef USE_LIGHTMAP
		vec4 lightMapTexel = texture2D( lightMap, vLightMapUv );
		reflectedLight.indirectDiffuse += lightMapTexel.rgb * lightMapIntensity * RECIPROCAL_PI;
	#else
		reflectedLight.indirectDiffuse += vec3( 1.0 );
	#endif
	#include <aomap_fragment>
	reflectedLight.indirectDiffuse *= diffuseColor.rgb;
	vec3 outgoingLight = reflectedLight.indirectDiffuse;
	#include <envmap_fragment>
	#include <opaque_fragment>
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
	#include <fog_fragment>
	#include <premultiplied_alpha_fragment>
	#include <dithering_fragment>
}`,meshlambert_vert:`#define LAMBERT
varying vec3 vViewPosition;
#include <common>
#include <batching_pars_vertex>
#include <uv_pars_vertex>
#include <displacementmap_pars_vertex>
#include <envmap_pars_vertex>
#include <color_pars_vertex>
#include <fog_pars_vertex>
#include <normal_pars_vertex>
#include <morphtarget_pars_vertex>
#include <skinning_pars_vertex>
#include <shadowmap_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>
void main() {
	#include <uv_vertex>
	#include <color_vertex>
	#include <morphinstance_vertex>
	#include <morphcolor_vertex>
	#include <batching_vertex>
	#include <beginnormal_vertex>
	#include <morphnormal_vertex>
	#include <skinbase_vertex>
	#include <skinnormal_vertex>
	#include <defaultnormal_vertex>
	#include <normal_vertex>
	#include <begin_vertex>
	#include <morphtarget_vertex>
	#include <skinning_vertex>
	#include <displacementmap_vertex>
	#include <project_vertex>
	#include <logdepthbuf_vertex>
	#include <clipping_planes_vertex>
	vViewPosition = - mvPosition.xyz;
	#include <worldpos_vertex>
	#include <envmap_vertex>
	#include <shadowmap_vertex>
	#include <fog_vertex>
}`,meshlambert_frag:`#define LAMBERT
uniform vec3 diffuse;
uniform vec3 emissive;
uniform float opacity;
#include <common>
#include <dithering_pars_fragment>
#include <color_pars_fragment>
#include <uv_pars_fragment>
#include <map_pars_fragment>
#include <alphamap_pars_fragment>
#include <alphatest_pars_fragment>
#include <alphahash_pars_fragment>
#include <aomap_pars_fragment>
#include <lightmap_pars_fragment>
#include <emissivemap_pars_fragment>
#include <envmap_common_pars_fragment>
#include <envmap_pars_fragment>
#include <envmap_physical_pars_fragment>
#include <fog_pars_fragment>
#include <bsdfs>
#include <lights_pars_begin>
#include <normal_pars_fragment>
#include <lights_lambert_pars_fragment>
#include <shadowmap_pars_fragment>
#include <bumpmap_pars_fragment>
#include <normalmap_pars_fragment>
#include <specularmap_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>
void main() {
	vec4 diffuseColor = vec4( diffuse, opacity );
	#include <clipping_planes_fragment>
	ReflectedLight reflectedLight = ReflectedLight( vec3( 0.0 ), vec3( 0.0 ), vec3( 0.0 ), vec3( 0.0 ) );
	vec3 totalEmissiveRadiance = emissive;
	#include <logdepthbuf_fragment>
	#include <map_fragment>
	#include <color_fragment>
	#include <alphamap_fragment>
	#include <alphatest_fragment>
	#include <alphahash_fragment>
	#include <specularmap_fragment>
	#include <normal_fragment_begin>
	#include <normal_fragment_maps>
	#include <emissivemap_fragment>
	#include <lights_lambert_fragment>
	#include <lights_fragment_begin>
	#include <lights_fragment_maps>
	#include <lights_fragment_end>
	#include <aomap_fragment>
	vec3 outgoingLight = reflectedLight.directDiffuse + reflectedLight.indirectDiffuse + totalEmissiveRadiance;
	#include <envmap_fragment>
	#include <opaque_fragment>
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
	#include <fog_fragment>
	#include <premultiplied_alpha_fragment>
	#include <dithering_fragment>
}`,meshmatcap_vert:`#define MATCAP
varying vec3 vViewPosition;
#include <common>
#include <batching_pars_vertex>
#include <uv_pars_vertex>
#include <color_pars_vertex>
#include <displacementmap_pars_vertex>
#include <fog_pars_vertex>
#include <normal_pars_vertex>
#include <morphtarget_pars_vertex>
#include <skinning_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>
void main() {
	#include <uv_vertex>
	#include <color_vertex>
	#include <morphinstance_vertex>
	#include <morphcolor_vertex>
	#include <batching_vertex>
	#include <beginnormal_vertex>
	#include <morphnormal_vertex>
	#include <skinbase_vertex>
	#include <skinnormal_vertex>
	#include <defaultnormal_vertex>
	#include <normal_vertex>
	#include <begin_vertex>
	#include <morphtarget_vertex>
	#include <skinning_vertex>
	#include <displacementmap_vertex>
	#include <project_vertex>
	#include <logdepthbuf_vertex>
	#include <clipping_planes_vertex>
	#include <fog_vertex>
	vViewPosition = - mvPosition.xyz;
}`,meshmatcap_frag:`#define MATCAP
uniform vec3 diffuse;
uniform float opacity;
uniform sampler2D matcap;
varying vec3 vViewPosition;
#include <common>
#include <dithering_pars_fragment>
#include <color_pars_fragment>
#include <uv_pars_fragment>
#include <map_pars_fragment>
#include <alphamap_pars_fragment>
#include <alphatest_pars_fragment>
#include <alphahash_pars_fragment>
#include <fog_pars_fragment>
#include <normal_pars_fragment>
#include <bumpmap_pars_fragment>
#include <normalmap_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>
void main() {
	vec4 diffuseColor = vec4( diffuse, opacity );
	#include <clipping_planes_fragment>
	#include <logdepthbuf_fragment>
	#include <map_fragment>
	#include <color_fragment>
	#include <alphamap_fragment>
	#include <alphatest_fragment>
	#include <alphahash_fragment>
	#include <normal_fragment_begin>
	#include <normal_fragment_maps>
	vec3 viewDir = normalize( vViewPosition );
	vec3 x = normalize( vec3( viewDir.z, 0.0, - viewDir.x ) );
	vec3 y = cross( viewDir, x );
	vec2 uv = vec2( dot( x, normal ), dot( y, normal ) ) * 0.495 + 0.5;
	#ifdef USE_MATCAP
		vec4 matcapColor = texture2D( matcap, uv );
	#else
		vec4 matcapColor = vec4( vec3( mix( 0.2, 0.8, uv.y ) ), 1.0 );
	#endif
	vec3 outgoingLight = diffuseColor.rgb * matcapColor.rgb;
	#include <opaque_fragment>
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
	#include <fog_fragment>
	#include <premultiplied_alpha_fragment>
	#include <dithering_fragment>
}`,meshnormal_vert:`#define NORMAL
#if defined( FLAT_SHADED ) || defined( USE_BUMPMAP ) || defined( USE_NORMALMAP_TANGENTSPACE )
	varying vec3 vViewPosition;
#endif
#include <common>
#include <batching_pars_vertex>
#include <uv_pars_vertex>
#include <displacementmap_pars_vertex>
#include <normal_pars_vertex>
#include <morphtarget_pars_vertex>
#include <skinning_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>
void main() {
	#include <uv_vertex>
	#include <batching_vertex>
	#include <beginnormal_vertex>
	#include <morphinstance_vertex>
	#include <morphnormal_vertex>
	#include <skinbase_vertex>
	#include <skinnormal_vertex>
	#include <defaultnormal_vertex>
	#include <normal_vertex>
	#include <begin_vertex>
	#include <morphtarget_vertex>
	#include <skinning_vertex>
	#include <displacementmap_vertex>
	#include <project_vertex>
	#include <logdepthbuf_vertex>
	#include <clipping_planes_vertex>
#if defined( FLAT_SHADED ) || defined( USE_BUMPMAP ) || defined( USE_NORMALMAP_TANGENTSPACE )
	vViewPosition = - mvPosition.xyz;
#endif
}`,meshnormal_frag:`#define NORMAL
uniform float opacity;
#if defined( FLAT_SHADED ) || defined( USE_BUMPMAP ) || defined( USE_NORMALMAP_TANGENTSPACE )
	varying vec3 vViewPosition;
#endif
#include <uv_pars_fragment>
#include <normal_pars_fragment>
#include <bumpmap_pars_fragment>
#include <normalmap_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>
void main() {
	vec4 diffuseColor = vec4( 0.0, 0.0, 0.0, opacity );
	#include <clipping_planes_fragment>
	#include <logdepthbuf_fragment>
	#include <normal_fragment_begin>
	#include <normal_fragment_maps>
	gl_FragColor = vec4( normalize( normal ) * 0.5 + 0.5, diffuseColor.a );
	#ifdef OPAQUE
		gl_FragColor.a = 1.0;
	#endif
}`,meshphong_vert:`#define PHONG
varying vec3 vViewPosition;
#include <common>
#include <batching_pars_vertex>
#include <uv_pars_vertex>
#include <displacementmap_pars_vertex>
#include <envmap_pars_vertex>
#include <color_pars_vertex>
#include <fog_pars_vertex>
#include <normal_pars_vertex>
#include <morphtarget_pars_vertex>
#include <skinning_pars_vertex>
#include <shadowmap_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>
void main() {
	#include <uv_vertex>
	#include <color_vertex>
	#include <morphcolor_vertex>
	#include <batching_vertex>
	#include <beginnormal_vertex>
	#include <morphinstance_vertex>
	#include <morphnormal_vertex>
	#include <skinbase_vertex>
	#include <skinnormal_vertex>
	#include <defaultnormal_vertex>
	#include <normal_vertex>
	#include <begin_vertex>
	#include <morphtarget_vertex>
	#include <skinning_vertex>
	#include <displacementmap_vertex>
	#include <project_vertex>
	#include <logdepthbuf_vertex>
	#include <clipping_planes_vertex>
	vViewPosition = - mvPosition.xyz;
	#include <worldpos_vertex>
	#include <envmap_vertex>
	#include <shadowmap_vertex>
	#include <fog_vertex>
}`,meshphong_frag:`#define PHONG
uniform vec3 diffuse;
uniform vec3 emissive;
uniform vec3 specular;
uniform float shininess;
uniform float opacity;
#include <common>
#include <dithering_pars_fragment>
#include <color_pars_fragment>
#include <uv_pars_fragment>
#include <map_pars_fragment>
#include <alphamap_pars_fragment>
#include <alphatest_pars_fragment>
#include <alphahash_pars_fragment>
#include <aomap_pars_fragment>
#include <lightmap_pars_fragment>
#include <emissivemap_pars_fragment>
#include <envmap_common_pars_fragment>
#include <envmap_pars_fragment>
#include <envmap_physical_pars_fragment>
#include <fog_pars_fragment>
#include <bsdfs>
#include <lights_pars_begin>
#include <normal_pars_fragment>
#include <lights_phong_pars_fragment>
#include <shadowmap_pars_fragment>
#include <bumpmap_pars_fragment>
#include <normalmap_pars_fragment>
#include <specularmap_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>
void main() {
	vec4 diffuseColor = vec4( diffuse, opacity );
	#include <clipping_planes_fragment>
	ReflectedLight reflectedLight = ReflectedLight( vec3( 0.0 ), vec3( 0.0 ), vec3( 0.0 ), vec3( 0.0 ) );
	vec3 totalEmissiveRadiance = emissive;
	#include <logdepthbuf_fragment>
	#include <map_fragment>
	#include <color_fragment>
	#include <alphamap_fragment>
	#include <alphatest_fragment>
	#include <alphahash_fragment>
	#include <specularmap_fragment>
	#include <normal_fragment_begin>
	#include <normal_fragment_maps>
	#include <emissivemap_fragment>
	#include <lights_phong_fragment>
	#include <lights_fragment_begin>
	#include <lights_fragment_maps>
	#include <lights_fragment_end>
	#include <aomap_fragment>
	vec3 outgoingLight = reflectedLight.directDiffuse + reflectedLight.indirectDiffuse + reflectedLight.directSpecular + reflectedLight.indirectSpecular + totalEmissiveRadiance;
	#include <envmap_fragment>
	#include <opaque_fragment>
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
	#include <fog_fragment>
	#include <premultiplied_alpha_fragment>
	#include <dithering_fragment>
}`,meshphysical_vert:`#define STANDARD
varying vec3 vViewPosition;
#ifdef USE_TRANSMISSION
	varying vec3 vWorldPosition;
#endif
#include <common>
#include <batching_pars_vertex>
#include <uv_pars_vertex>
#include <displacementmap_pars_vertex>
#include <color_pars_vertex>
#include <fog_pars_vertex>
#include <normal_pars_vertex>
#include <morphtarget_pars_vertex>
#include <skinning_pars_vertex>
#include <shadowmap_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>
void main() {
	#include <uv_vertex>
	#include <color_vertex>
	#include <morphinstance_vertex>
	#include <morphcolor_vertex>
	#include <batching_vertex>
	#include <beginnormal_vertex>
	#include <morphnormal_vertex>
	#include <skinbase_vertex>
	#include <skinnormal_vertex>
	#include <defaultnormal_vertex>
	#include <normal_vertex>
	#include <begin_vertex>
	#include <morphtarget_vertex>
	#include <skinning_vertex>
	#include <displacementmap_vertex>
	#include <project_vertex>
	#include <logdepthbuf_vertex>
	#include <clipping_planes_vertex>
	vViewPosition = - mvPosition.xyz;
	#include <worldpos_vertex>
	#include <shadowmap_vertex>
	#include <fog_vertex>
#ifdef USE_TRANSMISSION
	vWorldPosition = worldPosition.xyz;
#endif
}`,meshphysical_frag:`#define STANDARD
#ifdef PHYSICAL
	#define IOR
	#define USE_SPECULAR
#endif
uniform vec3 diffuse;
uniform vec3 emissive;
uniform float roughness;
uniform float metalness;
uniform float opacity;
#ifdef IOR
	uniform float ior;
#endif
#ifdef USE_SPECULAR
	uniform float specularIntensity;
	uniform vec3 specularColor;
	#ifdef USE_SPECULAR_COLORMAP
		uniform sampler2D specularColorMap;
	#endif
	#ifdef USE_SPECULAR_INTENSITYMAP
		uniform sampler2D specularIntensityMap;
	#endif
#endif
#ifdef USE_CLEARCOAT
	uniform float clearcoat;
	uniform float clearcoatRoughness;
#endif
#ifdef USE_DIFFUSE_ROUGHNESS
	uniform float diffuseRoughness;
	#ifdef USE_DIFFUSE_ROUGHNESSMAP
		uniform sampler2D diffuseRoughnessMap;
	#endif
#endif
#ifdef USE_DISPERSION
	uniform float dispersion;
#endif
#ifdef USE_RETROREFLECTION
	uniform float retroreflectivity;
#endif
#ifdef USE_IRIDESCENCE
	uniform float iridescence;
	uniform float iridescenceIOR;
	uniform float iridescenceThicknessMinimum;
	uniform float iridescenceThicknessMaximum;
#endif
#ifdef USE_SHEEN
	uniform vec3 sheenColor;
	uniform float sheenRoughness;
	#ifdef USE_SHEEN_COLORMAP
		uniform sampler2D sheenColorMap;
	#endif
	#ifdef USE_SHEEN_ROUGHNESSMAP
		uniform sampler2D sheenRoughnessMap;
	#endif
#endif
#ifdef USE_ANISOTROPY
	uniform vec2 anisotropyVector;
	#ifdef USE_ANISOTROPYMAP
		uniform sampler2D anisotropyMap;
	#endif
#endif
varying vec3 vViewPosition;
#include <common>
#include <dithering_pars_fragment>
#include <color_pars_fragment>
#include <uv_pars_fragment>
#include <map_pars_fragment>
#include <alphamap_pars_fragment>
#include <alphatest_pars_fragment>
#include <alphahash_pars_fragment>
#include <aomap_pars_fragment>
#include <lightmap_pars_fragment>
#include <emissivemap_pars_fragment>
#include <iridescence_fragment>
#include <envmap_common_pars_fragment>
#include <envmap_physical_pars_fragment>
#include <fog_pars_fragment>
#include <lights_pars_begin>
#include <normal_pars_fragment>
#include <lights_physical_pars_fragment>
#include <transmission_pars_fragment>
#include <shadowmap_pars_fragment>
#include <bumpmap_pars_fragment>
#include <normalmap_pars_fragment>
#include <clearcoat_pars_fragment>
#include <iridescence_pars_fragment>
#include <roughnessmap_pars_fragment>
#include <metalnessmap_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>
void main() {
	vec4 diffuseColor = vec4( diffuse, opacity );
	#include <clipping_planes_fragment>
	ReflectedLight reflectedLight = ReflectedLight( vec3( 0.0 ), vec3( 0.0 ), vec3( 0.0 ), vec3( 0.0 ) );
	vec3 totalEmissiveRadiance = emissive;
	#include <logdepthbuf_fragment>
	#include <map_fragment>
	#include <color_fragment>
	#include <alphamap_fragment>
	#include <alphatest_fragment>
	#include <alphahash_fragment>
	#include <roughnessmap_fragment>
	#include <metalnessmap_fragment>
	#include <normal_fragment_begin>
	#include <normal_fragment_maps>
	#include <clearcoat_normal_fragment_begin>
	#include <clearcoat_normal_fragment_maps>
	#include <emissivemap_fragment>
	#include <lights_physical_fragment>
	#include <lights_fragment_begin>
	#include <lights_fragment_maps>
	#include <lights_fragment_end>
	#include <aomap_fragment>
	vec3 totalDiffuse = reflectedLight.directDiffuse + reflectedLight.indirectDiffuse;
	vec3 totalSpecular = reflectedLight.directSpecular + reflectedLight.indirectSpecular;
	#include <transmission_fragment>
	vec3 outgoingLight = totalDiffuse + totalSpecular + totalEmissiveRadiance;
	#ifdef USE_SHEEN
 
		outgoingLight = outgoingLight + sheenSpecularDirect + sheenSpecularIndirect;
 
 	#endif
	#ifdef USE_CLEARCOAT
		float dotNVcc = saturate( dot( geometryClearcoatNormal, geometryViewDir ) );
		vec3 Fcc = F_Schlick( material.clearcoatF0, material.clearcoatF90, dotNVcc );
		outgoingLight = outgoingLight * ( 1.0 - material.clearcoat * Fcc ) + ( clearcoatSpecularDirect + clearcoatSpecularIndirect ) * material.clearcoat;
	#endif
	#include <opaque_fragment>
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
	#include <fog_fragment>
	#include <premultiplied_alpha_fragment>
	#include <dithering_fragment>
}`,meshtoon_vert:`#define TOON
varying vec3 vViewPosition;
#include <common>
#include <batching_pars_vertex>
#include <uv_pars_vertex>
#include <displacementmap_pars_vertex>
#include <color_pars_vertex>
#include <fog_pars_vertex>
#include <normal_pars_vertex>
#include <morphtarget_pars_vertex>
#include <skinning_pars_vertex>
#include <shadowmap_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>
void main() {
	#include <uv_vertex>
	#include <color_vertex>
	#include <morphinstance_vertex>
	#include <morphcolor_vertex>
	#include <batching_vertex>
	#include <beginnormal_vertex>
	#include <morphnormal_vertex>
	#include <skinbase_vertex>
	#include <skinnormal_vertex>
	#include <defaultnormal_vertex>
	#include <normal_vertex>
	#include <begin_vertex>
	#include <morphtarget_vertex>
	#include <skinning_vertex>
	#include <displacementmap_vertex>
	#include <project_vertex>
	#include <logdepthbuf_vertex>
	#include <clipping_planes_vertex>
	vViewPosition = - mvPosition.xyz;
	#include <worldpos_vertex>
	#include <shadowmap_vertex>
	#include <fog_vertex>
}`,meshtoon_frag:`#define TOON
uniform vec3 diffuse;
uniform vec3 emissive;
uniform float opacity;
#include <common>
#include <dithering_pars_fragment>
#include <color_pars_fragment>
#include <uv_pars_fragment>
#include <map_pars_fragment>
#include <alphamap_pars_fragment>
#include <alphatest_pars_fragment>
#include <alphahash_pars_fragment>
#include <aomap_pars_fragment>
#include <lightmap_pars_fragment>
#include <emissivemap_pars_fragment>
#include <gradientmap_pars_fragment>
#include <fog_pars_fragment>
#include <bsdfs>
#include <lights_pars_begin>
#include <normal_pars_fragment>
#include <lights_toon_pars_fragment>
#include <shadowmap_pars_fragment>
#include <bumpmap_pars_fragment>
#include <normalmap_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>
void main() {
	vec4 diffuseColor = vec4( diffuse, opacity );
	#include <clipping_planes_fragment>
	ReflectedLight reflectedLight = ReflectedLight( vec3( 0.0 ), vec3( 0.0 ), vec3( 0.0 ), vec3( 0.0 ) );
	vec3 totalEmissiveRadiance = emissive;
	#include <logdepthbuf_fragment>
	#include <map_fragment>
	#include <color_fragment>
	#include <alphamap_fragment>
	#include <alphatest_fragment>
	#include <alphahash_fragment>
	#include <normal_fragment_begin>
	#include <normal_fragment_maps>
	#include <emissivemap_fragment>
	#include <lights_toon_fragment>
	#include <lights_fragment_begin>
	#include <lights_fragment_maps>
	#include <lights_fragment_end>
	#include <aomap_fragment>
	vec3 outgoingLight = reflectedLight.directDiffuse + reflectedLight.indirectDiffuse + totalEmissiveRadiance;
	#include <opaque_fragment>
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
	#include <fog_fragment>
	#include <premultiplied_alpha_fragment>
	#include <dithering_fragment>
}`,points_vert:`uniform float size;
uniform float scale;
#include <common>
#include <color_pars_vertex>
#include <fog_pars_vertex>
#include <morphtarget_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>
#ifdef USE_POINTS_UV
	varying vec2 vUv;
	uniform mat3 uvTransform;
#endif
void main() {
	#ifdef USE_POINTS_UV
		vUv = ( uvTransform * vec3( uv, 1 ) ).xy;
	#endif
	#include <color_vertex>
	#include <morphinstance_vertex>
	#include <morphcolor_vertex>
	#include <begin_vertex>
	#include <morphtarget_vertex>
	#include <project_vertex>
	gl_PointSize = size;
	#ifdef USE_SIZEATTENUATION
		bool isPerspective = isPerspectiveMatrix( projectionMatrix );
		if ( isPerspective ) gl_PointSize *= ( scale / - mvPosition.z );
	#endif
	#include <logdepthbuf_vertex>
	#include <clipping_planes_vertex>
	#include <worldpos_vertex>
	#include <fog_vertex>
}`,points_frag:`uniform vec3 diffuse;
uniform float opacity;
#include <common>
#include <color_pars_fragment>
#include <map_particle_pars_fragment>
#include <alphatest_pars_fragment>
#include <alphahash_pars_fragment>
#include <fog_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>
void main() {
	vec4 diffuseColor = vec4( diffuse, opacity );
	#include <clipping_planes_fragment>
	vec3 outgoingLight = vec3( 0.0 );
	#include <logdepthbuf_fragment>
	#include <map_particle_fragment>
	#include <color_fragment>
	#include <alphatest_fragment>
	#include <alphahash_fragment>
	outgoingLight = diffuseColor.rgb;
	#include <opaque_fragment>
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
	#include <fog_fragment>
	#include <premultiplied_alpha_fragment>
}`,shadow_vert:`#include <common>
#include <batching_pars_vertex>
#include <fog_pars_vertex>
#include <morphtarget_pars_vertex>
#include <skinning_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <shadowmap_pars_vertex>
void main() {
	#include <batching_vertex>
	#include <beginnormal_vertex>
	#include <morphinstance_vertex>
	#include <morphnormal_vertex>
	#include <skinbase_vertex>
	#include <skinnormal_vertex>
	#include <defaultnormal_vertex>
	#include <begin_vertex>
	#include <morphtarget_vertex>
	#include <skinning_vertex>
	#include <project_vertex>
	#include <logdepthbuf_vertex>
	#include <worldpos_vertex>
	#include <shadowmap_vertex>
	#include <fog_vertex>
}`,shadow_frag:`uniform vec3 color;
uniform float opacity;
#include <common>
#include <fog_pars_fragment>
#include <bsdfs>
#include <lights_pars_begin>
#include <logdepthbuf_pars_fragment>
#include <shadowmap_pars_fragment>
#include <shadowmask_pars_fragment>
void main() {
	#include <logdepthbuf_fragment>
	gl_FragColor = vec4( color, opacity * ( 1.0 - getShadowMask() ) );
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
	#include <fog_fragment>
	#include <premultiplied_alpha_fragment>
}`,sprite_vert:`uniform float rotation;
uniform vec2 center;
#include <common>
#include <uv_pars_vertex>
#include <fog_pars_vertex>
#include <logdepthbuf_pars_vertex>
#include <clipping_planes_pars_vertex>
void main() {
	#include <uv_vertex>
	vec4 mvPosition = modelViewMatrix[ 3 ];
	vec2 scale = vec2( length( modelMatrix[ 0 ].xyz ), length( modelMatrix[ 1 ].xyz ) );
	#ifndef USE_SIZEATTENUATION
		bool isPerspective = isPerspectiveMatrix( projectionMatrix );
		if ( isPerspective ) scale *= - mvPosition.z;
	#endif
	vec2 alignedPosition = ( position.xy - ( center - vec2( 0.5 ) ) ) * scale;
	vec2 rotatedPosition;
	rotatedPosition.x = cos( rotation ) * alignedPosition.x - sin( rotation ) * alignedPosition.y;
	rotatedPosition.y = sin( rotation ) * alignedPosition.x + cos( rotation ) * alignedPosition.y;
	mvPosition.xy += rotatedPosition;
	gl_Position = projectionMatrix * mvPosition;
	#include <logdepthbuf_vertex>
	#include <clipping_planes_vertex>
	#include <fog_vertex>
}`,sprite_frag:`uniform vec3 diffuse;
uniform float opacity;
#include <common>
#include <uv_pars_fragment>
#include <map_pars_fragment>
#include <alphamap_pars_fragment>
#include <alphatest_pars_fragment>
#include <alphahash_pars_fragment>
#include <fog_pars_fragment>
#include <logdepthbuf_pars_fragment>
#include <clipping_planes_pars_fragment>
void main() {
	vec4 diffuseColor = vec4( diffuse, opacity );
	#include <clipping_planes_fragment>
	vec3 outgoingLight = vec3( 0.0 );
	#include <logdepthbuf_fragment>
	#include <map_fragment>
	#include <alphamap_fragment>
	#include <alphatest_fragment>
	#include <alphahash_fragment>
	outgoingLight = diffuseColor.rgb;
	#include <opaque_fragment>
	#include <tonemapping_fragment>
	#include <colorspace_fragment>
	#include <fog_fragment>
}`},Z={common:{diffuse:{value:new Y(16777215)},opacity:{value:1},map:{value:null},mapTransform:{value:new J},alphaMap:{value:null},alphaMapTransform:{value:new J},alphaTest:{value:0}},specularmap:{specularMap:{value:null},specularMapTransform:{value:new J}},envmap:{envMap:{value:null},envMapRotation:{value:new J},reflectivity:{value:1},ior:{value:1.5},refractionRatio:{value:.98},dfgLUT:{value:null}},aomap:{aoMap:{value:null},aoMapIntensity:{value:1},aoMapTransform:{value:new J}},lightmap:{lightMap:{value:null},lightMapIntensity:{value:1},lightMapTransform:{value:new J}},bumpmap:{bumpMap:{value:null},bumpMapTransform:{value:new J},bumpScale:{value:1}},normalmap:{normalMap:{value:null},normalMapTransform:{value:new J},normalScale:{value:new K(1,1)}},displacementmap:{displacementMap:{value:null},displacementMapTransform:{value:new J},displacementScale:{value:1},displacementBias:{value:0}},emissivemap:{emissiveMap:{value:null},emissiveMapTransform:{value:new J}},metalnessmap:{metalnessMap:{value:null},metalnessMapTransform:{value:new J}},roughnessmap:{roughnessMap:{value:null},roughnessMapTransform:{value:new J}},gradientmap:{gradientMap:{value:null}},fog:{fogDensity:{value:25e-5},fogNear:{value:1},fogFar:{value:2e3},fogColor:{value:new Y(16777215)}},lights:{ambientLightColor:{value:[]},lightProbe:{value:[]},sunLights:{value:[],properties:{direction:{},color:{}}},sunLightShadows:{value:[],properties:{shadowIntensity:1,shadowBias:{},shadowNormalBias:{},shadowRadius:{},shadowMapSize:{}}},sunShadowMatrix:{value:[]},sunShadowCascade:{value:[]},directionalLights:{value:[],properties:{direction:{},color:{}}},directionalLightShadows:{value:[],properties:{shadowIntensity:1,shadowBias:{},shadowNormalBias:{},shadowRadius:{},shadowMapSize:{}}},directionalShadowMatrix:{value:[]},spotLights:{value:[],properties:{color:{},position:{},direction:{},distance:{},coneCos:{},penumbraCos:{},decay:{}}},spotLightShadows:{value:[],properties:{shadowIntensity:1,shadowBias:{},shadowNormalBias:{},shadowRadius:{},shadowMapSize:{}}},spotLightMap:{value:[]},spotLightMatrix:{value:[]},pointLights:{value:[],properties:{color:{},position:{},decay:{},distance:{}}},pointLightShadows:{value:[],properties:{shadowIntensity:1,shadowBias:{},shadowNormalBias:{},shadowRadius:{},shadowMapSize:{},shadowCameraNear:{},shadowCameraFar:{}}},pointShadowMatrix:{value:[]},hemisphereLights:{value:[],properties:{direction:{},skyColor:{},groundColor:{}}},rectAreaLights:{value:[],properties:{color:{},position:{},width:{},height:{}}},ltc_1:{value:null},ltc_2:{value:null},probesSH:{value:[]},probesMin:{value:[]},probesMax:{value:[]},probesResolution:{value:[]}},points:{diffuse:{value:new Y(16777215)},opacity:{value:1},size:{value:1},scale:{value:1},map:{value:null},alphaMap:{value:null},alphaMapTransform:{value:new J},alphaTest:{value:0},uvTransform:{value:new J}},sprite:{diffuse:{value:new Y(16777215)},opacity:{value:1},center:{value:new K(.5,.5)},rotation:{value:0},map:{value:null},mapTransform:{value:new J},alphaMap:{value:null},alphaMapTransform:{value:new J},alphaTest:{value:0}}},yl={basic:{uniforms:rc([Z.common,Z.specularmap,Z.envmap,Z.aomap,Z.lightmap,Z.fog]),vertexShader:X.meshbasic_vert,fragmentShader:X.meshbasic_frag},lambert:{uniforms:rc([Z.common,Z.specularmap,Z.envmap,Z.aomap,Z.lightmap,Z.emissivemap,Z.bumpmap,Z.normalmap,Z.displacementmap,Z.fog,Z.lights,{emissive:{value:new Y(0)},envMapIntensity:{value:1}}]),vertexShader:X.meshlambert_vert,fragmentShader:X.meshlambert_frag},phong:{uniforms:rc([Z.common,Z.specularmap,Z.envmap,Z.aomap,Z.lightmap,Z.emissivemap,Z.bumpmap,Z.normalmap,Z.displacementmap,Z.fog,Z.lights,{emissive:{value:new Y(0)},specular:{value:new Y(1118481)},shininess:{value:30},envMapIntensity:{value:1}}]),vertexShader:X.meshphong_vert,fragmentShader:X.meshphong_frag},standard:{uniforms:rc([Z.common,Z.envmap,Z.aomap,Z.lightmap,Z.emissivemap,Z.bumpmap,Z.normalmap,Z.displacementmap,Z.roughnessmap,Z.metalnessmap,Z.fog,Z.lights,{emissive:{value:new Y(0)},roughness:{value:1},metalness:{value:0},envMapIntensity:{value:1}}]),vertexShader:X.meshphysical_vert,fragmentShader:X.meshphysical_frag},toon:{uniforms:rc([Z.common,Z.aomap,Z.lightmap,Z.emissivemap,Z.bumpmap,Z.normalmap,Z.displacementmap,Z.gradientmap,Z.fog,Z.lights,{emissive:{value:new Y(0)}}]),vertexShader:X.meshtoon_vert,fragmentShader:X.meshtoon_frag},matcap:{uniforms:rc([Z.common,Z.bumpmap,Z.normalmap,Z.displacementmap,Z.fog,{matcap:{value:null}}]),vertexShader:X.meshmatcap_vert,fragmentShader:X.meshmatcap_frag},points:{uniforms:rc([Z.points,Z.fog]),vertexShader:X.points_vert,fragmentShader:X.points_frag},dashed:{uniforms:rc([Z.common,Z.fog,{scale:{value:1},dashSize:{value:1},totalSize:{value:2}}]),vertexShader:X.linedashed_vert,fragmentShader:X.linedashed_frag},depth:{uniforms:rc([Z.common,Z.displacementmap]),vertexShader:X.depth_vert,fragmentShader:X.depth_frag},normal:{uniforms:rc([Z.common,Z.bumpmap,Z.normalmap,Z.displacementmap,{opacity:{value:1}}]),vertexShader:X.meshnormal_vert,fragmentShader:X.meshnormal_frag},sprite:{uniforms:rc([Z.sprite,Z.fog]),vertexShader:X.sprite_vert,fragmentShader:X.sprite_frag},background:{uniforms:{uvTransform:{value:new J},t2D:{value:null},backgroundIntensity:{value:1}},vertexShader:X.background_vert,fragmentShader:X.background_frag},backgroundCube:{uniforms:{envMap:{value:null},backgroundBlurriness:{value:0},backgroundIntensity:{value:1},backgroundRotation:{value:new J}},vertexShader:X.backgroundCube_vert,fragmentShader:X.backgroundCube_frag},cube:{uniforms:{tCube:{value:null},tFlip:{value:-1},opacity:{value:1}},vertexShader:X.cube_vert,fragmentShader:X.cube_frag},equirect:{uniforms:{tEquirect:{value:null}},vertexShader:X.equirect_vert,fragmentShader:X.equirect_frag},distance:{uniforms:rc([Z.common,Z.displacementmap,{referencePosition:{value:new q},nearDistance:{value:1},farDistance:{value:1e3}}]),vertexShader:X.distance_vert,fragmentShader:X.distance_frag},shadow:{uniforms:rc([Z.lights,Z.fog,{color:{value:new Y(0)},opacity:{value:1}}]),vertexShader:X.shadow_vert,fragmentShader:X.shadow_frag}};yl.physical={uniforms:rc([yl.standard.uniforms,{clearcoat:{value:0},clearcoatMap:{value:null},clearcoatMapTransform:{value:new J},clearcoatNormalMap:{value:null},clearcoatNormalMapTransform:{value:new J},clearcoatNormalScale:{value:new K(1,1)},clearcoatRoughness:{value:0},clearcoatRoughnessMap:{value:null},clearcoatRoughnessMapTransform:{value:new J},diffuseRoughness:{value:0},diffuseRoughnessMap:{value:null},diffuseRoughnessMapTransform:{value:new J},dispersion:{value:0},retroreflectivity:{value:0},iridescence:{value:0},iridescenceMap:{value:null},iridescenceMapTransform:{value:new J},iridescenceIOR:{value:1.3},iridescenceThicknessMinimum:{value:100},iridescenceThicknessMaximum:{value:400},iridescenceThicknessMap:{value:null},iridescenceThicknessMapTransform:{value:new J},sheen:{value:0},sheenColor:{value:new Y(0)},sheenColorMap:{value:null},sheenColorMapTransform:{value:new J},sheenRoughness:{value:1},sheenRoughnessMap:{value:null},sheenRoughnessMapTransform:{value:new J},transmission:{value:0},transmissionMap:{value:null},transmissionMapTransform:{value:new J},transmissionSamplerSize:{value:new K},transmissionSamplerMap:{value:null},thickness:{value:0},thicknessMap:{value:null},thicknessMapTransform:{value:new J},attenuationDistance:{value:0},attenuationColor:{value:new Y(0)},specularColor:{value:new Y(1,1,1)},specularColorMap:{value:null},specularColorMapTransform:{value:new J},specularIntensity:{value:1},specularIntensityMap:{value:null},specularIntensityMapTransform:{value:new J},anisotropyVector:{value:new K},anisotropyMap:{value:null},anisotropyMapTransform:{value:new J}}]),vertexShader:X.meshphysical_vert,fragmentShader:X.meshphysical_frag};var bl={r:0,b:0,g:0},xl=new Rr,Sl=new J;Sl.set(-1,0,0,0,1,0,0,0,1);function Cl(e,t,n,r,i,a){let o=new Y(0),s=i===!0?0:1,c,l,u=null,d=0,f=null;function p(e){let n=e.isScene===!0?e.background:null;if(n&&n.isTexture){let r=e.backgroundBlurriness>0;n=t.get(n,r)}return n}function m(t){let r=!1,i=p(t);i===null?g(o,s):i&&i.isColor&&(g(i,1),r=!0);let c=e.xr.getEnvironmentBlendMode();c===`additive`?n.buffers.color.setClear(0,0,0,1,a):c===`alpha-blend`&&n.buffers.color.setClear(0,0,0,0,a),(e.autoClear||r)&&(n.buffers.depth.setTest(!0),n.buffers.depth.setMask(!0),n.buffers.color.setMask(!0),e.clear(e.autoClearColor,e.autoClearDepth,e.autoClearStencil))}function h(t,n){let i=p(n);i&&i.isCubeTexture?(l===void 0&&(l=new Ha(new Po(1,1,1),new uc({name:`BackgroundCubeMaterial`,uniforms:nc(yl.backgroundCube.uniforms),vertexShader:yl.backgroundCube.vertexShader,fragmentShader:yl.backgroundCube.fragmentShader,side:1,depthTest:!1,depthWrite:!1,fog:!1,allowOverride:!1})),l.geometry.deleteAttribute(`normal`),l.geometry.deleteAttribute(`uv`),l.onBeforeRender=function(e,t,n){this.matrixWorld.copyPosition(n.matrixWorld)},Object.defineProperty(l.material,"envMap",{get:function(){return this.uniforms.envMap.value}}),r.update(l)),l.material.uniforms.envMap.value=i,l.material.uniforms.backgroundBlurriness.value=n.backgroundBlurriness,l.material.uniforms.backgroundIntensity.value=n.backgroundIntensity,l.material.uniforms.backgroundRotation.value.setFromMatrix4(xl.makeRotationFromEuler(n.backgroundRotation)).transpose(),i.isRenderTargetTexture===!1&&l.material.uniforms.backgroundRotation.value.premultiply(Sl),l.material.toneMapped=Sr.getTransfer(i.colorSpace)!==En,(u!==i||d!==i.version||f!==e.toneMapping)&&(l.material.needsUpdate=!0,u=i,d=i.version,f=e.toneMapping),l.layers.enableAll(),t.unshift(l,l.geometry,l.material,0,0,null)):i&&i.isTexture&&(c===void 0&&(c=new Ha(new Qs(2,2),new uc({name:`BackgroundMaterial`,uniforms:nc(yl.background.uniforms),vertexShader:yl.background.vertexShader,fragmentShader:yl.background.fragmentShader,side:0,depthTest:!1,depthWrite:!1,fog:!1,allowOverride:!1})),c.geometry.deleteAttribute(`normal`),Object.defineProperty(c.material,"map",{get:function(){return this.uniforms.t2D.value}}),r.update(c)),c.material.uniforms.t2D.value=i,c.material.uniforms.backgroundIntensity.value=n.backgroundIntensity,c.material.toneMapped=Sr.getTransfer(i.colorSpace)!==En,i.matrixAutoUpdate===!0&&i.updateMatrix(),c.material.uniforms.uvTransform.value.copy(i.matrix),(u!==i||d!==i.version||f!==e.toneMapping)&&(c.material.needsUpdate=!0,u=i,d=i.version,f=e.toneMapping),c.layers.enableAll(),t.unshift(c,c.geometry,c.material,0,0,null))}function g(t,r){t.getRGB(bl,oc(e)),n.buffers.color.setClear(bl.r,bl.g,bl.b,r,a)}function _(){l!==void 0&&(l.geometry.dispose(),l.material.dispose(),l=void 0),c!==void 0&&(c.geometry.dispose(),c.material.dispose(),c=void 0)}return{getClearColor:function(){return o},setClearColor:function(e,t=1){o.set(e),s=t,g(o,s)},getClearAlpha:function(){return s},setClearAlpha:function(e){s=e,g(o,s)},render:m,addToRenderList:h,dispose:_}}function wl(e,t){let n=e.getParameter(e.MAX_VERTEX_ATTRIBS),r={},i=f(null),a=i,o=!1;function s(n,r,i,s,c){let u=!1,f=d(n,s,i,r);a!==f&&(a=f,l(a.object)),u=p(n,s,i,c),u&&m(n,s,i,c),c!==null&&t.update(c,e.ELEMENT_ARRAY_BUFFER),(u||o)&&(o=!1,b(n,r,i,s),c!==null&&e.bindBuffer(e.ELEMENT_ARRAY_BUFFER,t.get(c).buffer))}function c(){return e.createVertexArray()}function l(t){return e.bindVertexArray(t)}function u(t){return e.deleteVertexArray(t)}function d(e,t,n,i){let a=i.wireframe===!0,o=r[t.id];o===void 0&&(o={},r[t.id]=o);let s=e.isInstancedMesh===!0?e.id:0,l=o[s];l===void 0&&(l={},o[s]=l);let u=l[n.id];u===void 0&&(u={},l[n.id]=u);let d=u[a];return d===void 0&&(d=f(c()),u[a]=d),d}function f(e){let t=[],r=[],i=[];for(let e=0;e<n;e++)t[e]=0,r[e]=0,i[e]=0;return{geometry:null,program:null,wireframe:!1,newAttributes:t,enabledAttributes:r,attributeDivisors:i,object:e,attributes:{},index:null}}function p(e,t,n,r){let i=a.attributes,o=t.attributes,s=0,c=n.getAttributes();for(let t in c)if(c[t].location>=0){let n=i[t],r=o[t];if(r===void 0&&(t===`instanceMatrix`&&e.instanceMatrix&&(r=e.instanceMatrix),t===`instanceColor`&&e.instanceColor&&(r=e.instanceColor)),n===void 0||n.attribute!==r||r&&n.data!==r.data)return!0;s++}return a.attributesNum!==s||a.index!==r}function m(e,t,n,r){let i={},o=t.attributes,s=0,c=n.getAttributes();for(let t in c)if(c[t].location>=0){let n=o[t];n===void 0&&(t===`instanceMatrix`&&e.instanceMatrix&&(n=e.instanceMatrix),t===`instanceColor`&&e.instanceColor&&(n=e.instanceColor));let r={};r.attribute=n,n&&n.data&&(r.data=n.data),i[t]=r,s++}a.attributes=i,a.attributesNum=s,a.index=r}function h(){let e=a.newAttributes;for(let t=0,n=e.length;t<n;t++)e[t]=0}function g(e){_(e,0)}function _(t,n){let r=a.newAttributes,i=a.enabledAttributes,o=a.attributeDivisors;r[t]=1,i[t]===0&&(e.enableVertexAttribArray(t),i[t]=1),o[t]!==n&&(e.vertexAttribDivisor(t,n),o[t]=n)}function v(){let t=a.newAttributes,n=a.enabledAttributes;for(let r=0,i=n.length;r<i;r++)n[r]!==t[r]&&(e.disableVertexAttribArray(r),n[r]=0)}function y(t,n,r,i,a,o,s){s===!0?e.vertexAttribIPointer(t,n,r,a,o):e.vertexAttribPointer(t,n,r,i,a,o)}function b(n,r,i,a){h();let o=a.attributes,s=i.getAttributes(),c=r.defaultAttributeValues;for(let r in s){let i=s[r];if(i.location>=0){let s=o[r];if(s===void 0&&(r===`instanceMatrix`&&n.instanceMatrix&&(s=n.instanceMatrix),r===`instanceColor`&&n.instanceColor&&(s=n.instanceColor)),s!==void 0){let r=s.normalized,o=s.itemSize,c=t.get(s);if(c===void 0)continue;let l=c.buffer,u=c.type,d=c.bytesPerElement,f=u===e.INT||u===e.UNSIGNED_INT||s.gpuType===1013;if(s.isInterleavedBufferAttribute){let t=s.data,c=t.isInterleavedBuffer===!0?t.stride:t.itemSize,p=s.offset;if(t.isInstancedInterleavedBuffer||t.isInstancedBufferAttribute){for(let e=0;e<i.locationSize;e++)_(i.location+e,t.meshPerAttribute);n.isInstancedMesh!==!0&&a._maxInstanceCount===void 0&&(a._maxInstanceCount=t.meshPerAttribute*t.count)}else for(let e=0;e<i.locationSize;e++)g(i.location+e);e.bindBuffer(e.ARRAY_BUFFER,l);for(let e=0;e<i.locationSize;e++)y(i.location+e,o/i.locationSize,u,r,c*d,(p+o/i.locationSize*e)*d,f)}else{if(s.isInstancedBufferAttribute){for(let e=0;e<i.locationSize;e++)_(i.location+e,s.meshPerAttribute);n.isInstancedMesh!==!0&&a._maxInstanceCount===void 0&&(a._maxInstanceCount=s.meshPerAttribute*s.count)}else for(let e=0;e<i.locationSize;e++)g(i.location+e);e.bindBuffer(e.ARRAY_BUFFER,l);for(let e=0;e<i.locationSize;e++)y(i.location+e,o/i.locationSize,u,r,o*d,o/i.locationSize*e*d,f)}}else if(c!==void 0){let t=c[r];if(t!==void 0)switch(t.length){case 2:e.vertexAttrib2fv(i.location,t);break;case 3:e.vertexAttrib3fv(i.location,t);break;case 4:e.vertexAttrib4fv(i.location,t);break;default:e.vertexAttrib1fv(i.location,t)}}}}v()}function x(){T();for(let e in r){let t=r[e];for(let e in t){let n=t[e];for(let e in n){let t=n[e];for(let e in t)u(t[e].object),delete t[e];delete n[e]}}delete r[e]}}function S(e){if(r[e.id]===void 0)return;let t=r[e.id];for(let e in t){let n=t[e];for(let e in n){let t=n[e];for(let e in t)u(t[e].object),delete t[e];delete n[e]}}delete r[e.id]}function C(e){for(let t in r){let n=r[t];for(let t in n){let r=n[t];if(r[e.id]===void 0)continue;let i=r[e.id];for(let e in i)u(i[e].object),delete i[e];delete r[e.id]}}}function w(e){for(let t in r){let n=r[t],i=e.isInstancedMesh===!0?e.id:0,a=n[i];if(a!==void 0){for(let e in a){let t=a[e];for(let e in t)u(t[e].object),delete t[e];delete a[e]}delete n[i],Object.keys(n).length===0&&delete r[t]}}}function T(){E(),o=!0,a!==i&&(a=i,l(a.object))}function E(){i.geometry=null,i.program=null,i.wireframe=!1}return{setup:s,reset:T,resetDefaultState:E,dispose:x,releaseStatesOfGeometry:S,releaseStatesOfObject:w,releaseStatesOfProgram:C,initAttributes:h,enableAttribute:g,disableUnusedAttributes:v}}function Tl(e,t,n){let r;function i(e){r=e}function a(t,i){e.drawArrays(r,t,i),n.update(i,r,1)}function o(t,i,a){a!==0&&(e.drawArraysInstanced(r,t,i,a),n.update(i,r,a))}function s(e,i,a){if(a===0)return;t.get(`WEBGL_multi_draw`).multiDrawArraysWEBGL(r,e,0,i,0,a);let o=0;for(let e=0;e<a;e++)o+=i[e];n.update(o,r,1)}this.setMode=i,this.render=a,this.renderInstances=o,this.renderMultiDraw=s}function El(e,t,n,r){let i;function a(){if(i!==void 0)return i;if(t.has(`EXT_texture_filter_anisotropic`)===!0){let n=t.get(`EXT_texture_filter_anisotropic`);i=e.getParameter(n.MAX_TEXTURE_MAX_ANISOTROPY_EXT)}else i=0;return i}function o(t){return t===1023||r.convert(t)===e.getParameter(e.IMPLEMENTATION_COLOR_READ_FORMAT)}function s(n){let i=n===1016&&(t.has(`EXT_color_buffer_half_float`)||t.has(`EXT_color_buffer_float`));return!(n!==1009&&n!==1015&&!i&&r.convert(n)!==e.getParameter(e.IMPLEMENTATION_COLOR_READ_TYPE))}function c(t){if(t===`highp`){if(e.getShaderPrecisionFormat(e.VERTEX_SHADER,e.HIGH_FLOAT).precision>0&&e.getShaderPrecisionFormat(e.FRAGMENT_SHADER,e.HIGH_FLOAT).precision>0)return`highp`;t=`mediump`}return t===`mediump`&&e.getShaderPrecisionFormat(e.VERTEX_SHADER,e.MEDIUM_FLOAT).precision>0&&e.getShaderPrecisionFormat(e.FRAGMENT_SHADER,e.MEDIUM_FLOAT).precision>0?`mediump`:`lowp`}let l=n.precision===void 0?`highp`:n.precision,u=c(l);u!==l&&(U(`WebGLRenderer:`,l,`not supported, using`,u,`instead.`),l=u);let d=n.reversedDepthBuffer===!0&&t.has(`EXT_clip_control`),f=n.logarithmicDepthBuffer===!0&&d===!1;n.reversedDepthBuffer===!0&&d===!1&&U(`WebGLRenderer: Unable to use reversed depth buffer due to missing EXT_clip_control extension. Fallback to default depth buffer.`),n.logarithmicDepthBuffer===!0&&d===!0&&U(`WebGLRenderer: Logarithmic depth buffer is ignored when reversed depth buffer is enabled.`);let p=e.getParameter(e.MAX_TEXTURE_IMAGE_UNITS),m=e.getParameter(e.MAX_VERTEX_TEXTURE_IMAGE_UNITS),h=e.getParameter(e.MAX_TEXTURE_SIZE),g=e.getParameter(e.MAX_CUBE_MAP_TEXTURE_SIZE),_=e.getParameter(e.MAX_VERTEX_ATTRIBS),v=e.getParameter(e.MAX_VERTEX_UNIFORM_VECTORS),y=e.getParameter(e.MAX_VARYING_VECTORS),b=e.getParameter(e.MAX_FRAGMENT_UNIFORM_VECTORS),x=e.getParameter(e.MAX_SAMPLES),S=e.getParameter(e.SAMPLES);return{isWebGL2:!0,getMaxAnisotropy:a,getMaxPrecision:c,textureFormatReadable:o,textureTypeReadable:s,precision:l,logarithmicDepthBuffer:f,reversedDepthBuffer:d,maxTextures:p,maxVertexTextures:m,maxTextureSize:h,maxCubemapSize:g,maxAttributes:_,maxVertexUniforms:v,maxVaryings:y,maxFragmentUniforms:b,maxSamples:x,samples:S}}function Dl(e){let t=this,n=null,r=0,i=!1,a=!1,o=new Sa,s=new J,c={value:null,needsUpdate:!1};this.uniform=c,this.numPlanes=0,this.numIntersection=0,this.init=function(e,t){let n=e.length!==0||t||r!==0||i;return i=t,r=e.length,n},this.beginShadows=function(){a=!0,u(null)},this.endShadows=function(){a=!1},this.setGlobalState=function(e,t){n=u(e,t,0)},this.setState=function(t,o,s){let d=t.clippingPlanes,f=t.clipIntersection,p=t.clipShadows,m=e.get(t);if(!i||d===null||d.length===0||a&&!p)a?u(null):l();else{let e=a?0:r,t=e*4,i=m.clippingState||null;c.value=i,i=u(d,o,t,s);for(let e=0;e!==t;++e)i[e]=n[e];m.clippingState=i,this.numIntersection=f?this.numPlanes:0,this.numPlanes+=e}};function l(){c.value!==n&&(c.value=n,c.needsUpdate=r>0),t.numPlanes=r,t.numIntersection=0}function u(e,n,r,i){let a=e===null?0:e.length,l=null;if(a!==0){if(l=c.value,i!==!0||l===null){let t=r+a*4,i=n.matrixWorldInverse;s.getNormalMatrix(i),(l===null||l.length<t)&&(l=new Float32Array(t));for(let t=0,n=r;t!==a;++t,n+=4)o.copy(e[t]).applyMatrix4(i,s),o.normal.toArray(l,n),l[n+3]=o.constant}c.value=l,c.needsUpdate=!0}return t.numPlanes=a,t.numIntersection=0,l}}var Ol=class extends Fr{constructor(e=1,t={}){super(e,e,t),this.isWebGLCubeRenderTarget=!0;let n={width:e,height:e,depth:1},r=[n,n,n,n,n,n];this.texture=new ko(r),this._setTextureOptions(t),this.texture.isRenderTargetTexture=!0}fromEquirectangularTexture(e,t){this.texture.type=t.type,this.texture.colorSpace=t.colorSpace,this.texture.generateMipmaps=t.generateMipmaps,this.texture.minFilter=t.minFilter,this.texture.magFilter=t.magFilter;let n={uniforms:{tEquirect:{value:null}},vertexShader:`

				varying vec3 vWorldDirection;

				vec3 transformDirection( in vec3 dir, in mat4 matrix ) {

					return normalize( ( matrix * vec4( dir, 0.0 ) ).xyz );

				}

				void main() {

					vWorldDirection = transformDirection( position, modelMatrix );

					#include <begin_vertex>
					#include <project_vertex>

				}
			`,fragmentShader:`

				uniform sampler2D tEquirect;

				varying vec3 vWorldDirection;

				#include <common>

				void main() {

					vec3 direction = normalize( vWorldDirection );

					vec2 sampleUV = equirectUv( direction );

					gl_FragColor = texture2D( tEquirect, sampleUV );

				}
			`},r=new Po(5,5,5),i=new uc({name:`CubemapFromEquirect`,uniforms:nc(n.uniforms),vertexShader:n.vertexShader,fragmentShader:n.fragmentShader,side:1,blending:0});i.uniforms.tEquirect.value=t;let a=new Ha(r,i),o=t.minFilter;return t.minFilter===1008&&(t.minFilter=ot),new Gc(1,10,this).update(e,a),t.minFilter=o,a.geometry.dispose(),a.material.dispose(),this}clear(e,t=!0,n=!0,r=!0){let i=e.getRenderTarget();for(let i=0;i<6;i++)e.setRenderTarget(this,i),e.clear(t,n,r);e.setRenderTarget(i)}},kl=256,Al=3,jl=20,Ml=256,Nl=16,Pl=3,Fl=new q,Il=new Y,Ll=class e{constructor(e){this._renderer=e,this._cubeSize=0,this._sourceTarget=null,this._cubeCamera=new Gc(1,10,null),this._boxMesh=new Ha(new Po(5,5,5),null),this._cubemapMaterial=null,this._equirectMaterial=null,this._blurMaterial=null,this._ggxMaterial=null,this._integrationMaterial=null}fromScene(e,t=0,n=.1,r=100,i={}){let{size:a=256,position:o=Fl}=i,s=this._renderer;this._setSize(a);let c=this._allocateTarget(),l=this._getSourceTarget(!0);t>0&&(l.texture.mipmapsAutoUpdate=!1);let u=s.autoClear,d=s.autoClearColor,f=s.autoClearDepth,p=s.autoClearStencil,m=e.background;s.autoClear=!0,s.autoClearColor=!0,s.autoClearDepth=!0,s.autoClearStencil=!0,m===null&&(e.background=s.getClearColor(Il));let h=new Gc(n,r,l);return h.position.copy(o),h.update(s,e),s.autoClear=u,s.autoClearColor=d,s.autoClearDepth=f,s.autoClearStencil=p,e.background=m,t>0&&(l.texture.mipmapsAutoUpdate=!0,this._blur(c,t)),this._applyPMREM(c),c}fromEquirectangular(e,t=null){return this._fromTexture(e,t)}fromCubemap(e,t=null){return this._fromTexture(e,t)}compileCubemapShader(){this._cubemapMaterial===null&&(this._cubemapMaterial=Wl(),this._compileMaterial(this._cubemapMaterial))}compileEquirectangularShader(){this._equirectMaterial===null&&(this._equirectMaterial=Ul(),this._compileMaterial(this._equirectMaterial))}dispose(){this._sourceTarget!==null&&this._sourceTarget.dispose(),this._cubemapMaterial!==null&&this._cubemapMaterial.dispose(),this._equirectMaterial!==null&&this._equirectMaterial.dispose(),this._blurMaterial!==null&&this._blurMaterial.dispose(),this._ggxMaterial!==null&&this._ggxMaterial.dispose(),this._integrationMaterial!==null&&this._integrationMaterial.dispose(),this._boxMesh.geometry.dispose()}static lodToRoughness(e,t){return t>0?1-Math.sqrt(1-e/t):0}_setSize(e){this._cubeSize=Math.max(kl,lr(e))}_fromTexture(e,t){e.mapping===301||e.mapping===302?this._setSize(e.image.length===0?kl:e.image[0].width||e.image[0].image.width):this._setSize(e.image.width/4);let n=t||this._allocateTarget();return this._textureToCubemap(e),this._applyPMREM(n),n}_allocateTarget(){let e=this._cubeSize,t=Rl(e,!1,!1),n=Math.log2(e)-Al;for(let r=0;r<=n;r++)t.texture.mipmaps.push({width:e>>r,height:e>>r});return t.texture.name=`PMREM`,t.texture.isPMREMTexture=!0,t}_getSourceTarget(e=!1){let t=this._cubeSize,n=this._sourceTarget;return(n===null||n.width!==t||e&&n.depthBuffer===!1)&&(n!==null&&n.dispose(),this._sourceTarget=Rl(t,!0,e)),this._sourceTarget}_compileMaterial(e){this._boxMesh.material=e,this._renderer.compile(this._boxMesh,this._cubeCamera.children[0])}_renderCube(e,t,n){let r=this._boxMesh,i=this._cubeCamera;r.material=n,i.renderTarget=e,i.activeMipmapLevel=t;let a=e.width>>t;e.viewport.set(0,0,a,a),i.update(this._renderer,r),e.viewport.set(0,0,e.width,e.height)}_textureToCubemap(e){let t;e.mapping===301||e.mapping===302?(this._cubemapMaterial===null&&(this._cubemapMaterial=Wl()),t=this._cubemapMaterial,t.uniforms.flipEnvMap.value=e.isRenderTargetTexture===!1?-1:1):(this._equirectMaterial===null&&(this._equirectMaterial=Ul()),t=this._equirectMaterial),t.uniforms.envMap.value=e,this._renderCube(this._getSourceTarget(),0,t)}_applyPMREM(t){this._ggxMaterial===null&&(this._ggxMaterial=Bl(),this._integrationMaterial=Vl());let n=this._cubeSize,r=t.texture.mipmaps.length-1,i=this._ggxMaterial.uniforms;i.envMap.value=this._sourceTarget.texture;let a=this._integrationMaterial.uniforms;a.envMap.value=this._sourceTarget.texture,a.sourceLod.value=Math.log2(n/Nl);for(let o=0;o<=r;o++){let s=e.lodToRoughness(o,r);if(o>r-Pl)a.roughness.value=s,this._renderCube(t,o,this._integrationMaterial);else{let e=s>0?Math.log2(n)+.5*Math.log2(6/(Ml*s**4))+.5:0;i.roughness.value=s,i.lodBias.value=e,this._renderCube(t,o,this._ggxMaterial)}}}_blur(e,t){this._blurMaterial===null&&(this._blurMaterial=Hl());let n=this._blurMaterial,r=n.uniforms,i=this._sourceTarget;r.sigma.value=Math.min(t,Math.PI)/Math.SQRT2,r.envMap.value=i.texture,this._renderCube(e,0,n),r.envMap.value=e.texture,this._renderCube(i,0,n)}};function Rl(e,t,n){return new Ol(e,{minFilter:ct,generateMipmaps:t,type:gt,colorSpace:wn,depthBuffer:n})}function zl(e,t,n){return new uc({name:e,uniforms:t,vertexShader:X.cube_vert,fragmentShader:n,side:1,blending:0,depthTest:!1,depthWrite:!1})}function Bl(){return zl(`PMREMGGXConvolution`,{envMap:{value:null},roughness:{value:0},lodBias:{value:0}},`

		#define GGX_SAMPLES ${Ml}u

		varying vec3 vWorldDirection;

		uniform samplerCube envMap;
		uniform float roughness;
		uniform float lodBias;

		#include <common>

		// Van der Corput radical inverse
		float radicalInverse_VdC( uint bits ) {

			bits = ( bits << 16u ) | ( bits >> 16u );
			bits = ( ( bits & 0x55555555u ) << 1u ) | ( ( bits & 0xAAAAAAAAu ) >> 1u );
			bits = ( ( bits & 0x33333333u ) << 2u ) | ( ( bits & 0xCCCCCCCCu ) >> 2u );
			bits = ( ( bits & 0x0F0F0F0Fu ) << 4u ) | ( ( bits & 0xF0F0F0F0u ) >> 4u );
			bits = ( ( bits & 0x00FF00FFu ) << 8u ) | ( ( bits & 0xFF00FF00u ) >> 8u );
			return float( bits ) * 2.3283064365386963e-10; // / 0x100000000

		}

		// Hammersley sequence
		vec2 hammersley( uint i, uint N ) {

			return vec2( float( i ) / float( N ), radicalInverse_VdC( i ) );

		}

		void main() {

			vec3 N = normalize( vWorldDirection );

			// For very low roughness, just sample the environment directly
			if ( roughness < 0.001 ) {

				gl_FragColor = vec4( textureLod( envMap, N, 0.0 ).rgb, 1.0 );
				return;

			}

			float alpha = roughness * roughness;
			float alpha2 = alpha * alpha;

			// Tangent space basis for VNDF sampling
			vec3 up = abs( N.z ) < 0.999 ? vec3( 0.0, 0.0, 1.0 ) : vec3( 1.0, 0.0, 0.0 );
			vec3 tangent = normalize( cross( up, N ) );
			vec3 bitangent = cross( N, tangent );

			vec3 prefilteredColor = vec3( 0.0 );
			float totalWeight = 0.0;

			for ( uint i = 0u; i < GGX_SAMPLES; i ++ ) {

				vec2 Xi = hammersley( i, GGX_SAMPLES );

				// With V = N, sample the reflected direction directly.
				float invQ = 1.0 / ( 1.0 - Xi.x + alpha2 * Xi.x );
				float NdotL = ( 1.0 - Xi.x - alpha2 * Xi.x ) * invQ;

				if ( NdotL > 0.0 ) {

					float phi = 2.0 * PI * Xi.y;
					float sinTheta = 2.0 * alpha * sqrt( Xi.x * ( 1.0 - Xi.x ) ) * invQ;
					vec3 L = N * NdotL + ( tangent * cos( phi ) + bitangent * sin( phi ) ) * sinTheta;

					// Match the source mip to the sample's solid angle. The terms
					// independent of the sample are precomputed in lodBias.
					float d = alpha2 * invQ;
					float lod = max( log2( d ) + lodBias, 0.0 );

					// Weight by NdotL for the split-sum approximation
					prefilteredColor += textureLod( envMap, L, lod ).rgb * NdotL;
					totalWeight += NdotL;

				}

			}

			gl_FragColor = vec4( prefilteredColor / totalWeight, 1.0 );

		}
	`)}function Vl(){return zl(`PMREMGGXIntegration`,{envMap:{value:null},roughness:{value:0},sourceLod:{value:0},sourceSize:{value:Nl}},`

		varying vec3 vWorldDirection;

		uniform samplerCube envMap;
		uniform float roughness;
		uniform float sourceLod;
		uniform int sourceSize;

		void main() {

			vec3 N = normalize( vWorldDirection );

			float alpha = roughness * roughness;
			float alpha2 = alpha * alpha;

			float texelSize = 2.0 / float( sourceSize );

			vec3 prefilteredColor = vec3( 0.0 );
			float totalWeight = 0.0;

			// Pair opposite texels: only the one in N's hemisphere contributes.
			for ( int face = 0; face < 3; face ++ ) {

				for ( int y = 0; y < sourceSize; y ++ ) {

					for ( int x = 0; x < sourceSize; x ++ ) {

						vec2 uv = ( vec2( x, y ) + 0.5 ) * texelSize - 1.0;
						vec3 texelDirection = face == 0 ? vec3( 1.0, uv ) : ( face == 1 ? vec3( uv.x, 1.0, uv.y ) : vec3( uv, 1.0 ) );

						float invDistance = inversesqrt( 1.0 + dot( uv, uv ) );
						float NdotL = dot( N, texelDirection );
						texelDirection *= NdotL < 0.0 ? - 1.0 : 1.0;
						NdotL = abs( NdotL ) * invDistance;

						// With V = N, NdotH squared is ( 1 + NdotL ) / 2. Common factors
						// in the GGX distribution and texel solid angle cancel when normalized.
						float d = 1.0 + alpha2 + ( alpha2 - 1.0 ) * NdotL;
						float weight = NdotL * invDistance * invDistance * invDistance / ( d * d );

						prefilteredColor += textureLod( envMap, texelDirection, sourceLod ).rgb * weight;
						totalWeight += weight;

					}

				}

			}

			gl_FragColor = vec4( prefilteredColor / totalWeight, 1.0 );

		}
	`)}function Hl(){return zl(`PMREMSphericalGaussianBlur`,{envMap:{value:null},sigma:{value:0}},`

		#define SAMPLES ${jl}
		#define GOLDEN_ANGLE 2.39996322973

		varying vec3 vWorldDirection;

		uniform samplerCube envMap;
		uniform float sigma;

		#include <common>

		void main() {

			vec3 outputDirection = normalize( vWorldDirection );

			vec3 up = abs( outputDirection.z ) < 0.999 ? vec3( 0.0, 0.0, 1.0 ) : vec3( 1.0, 0.0, 0.0 );
			vec3 tangent = normalize( cross( up, outputDirection ) );
			vec3 bitangent = cross( outputDirection, tangent );

			// Truncate the kernel at three standard deviations or at the antipode.
			float thetaMax = min( 3.0 * sigma, PI );
			float truncation = 1.0 - exp( - 0.5 * thetaMax * thetaMax / ( sigma * sigma ) );

			vec3 accumColor = vec3( 0.0 );
			float accumWeight = 0.0;

			for ( int i = 0; i < SAMPLES; i ++ ) {

				// Stratified inverse-CDF sampling of the Gaussian, placed on a golden-angle spiral.
				float stratum = ( float( i ) + 0.5 ) / float( SAMPLES );
				float theta = sigma * sqrt( - 2.0 * log( 1.0 - stratum * truncation ) );
				float phi = float( i ) * GOLDEN_ANGLE;

				vec3 offset = cos( phi ) * tangent + sin( phi ) * bitangent;
				vec3 sampleDirection = cos( theta ) * outputDirection + sin( theta ) * offset;

				// Correct the planar sample density to solid angle.
				float weight = sin( theta ) / theta;

				accumColor += weight * textureLod( envMap, sampleDirection, 0.0 ).rgb;
				accumWeight += weight;

			}

			gl_FragColor = vec4( accumColor / accumWeight, 1.0 );

		}
	`)}function Ul(){return zl(`PMREMEquirectangularToCubemap`,{envMap:{value:null}},`

		varying vec3 vWorldDirection;

		uniform sampler2D envMap;

		#include <common>

		void main() {

			// Average four subpixel samples to preserve small, bright features.
			vec3 direction = normalize( vWorldDirection );
			vec3 dx = dFdx( direction ) * 0.25;
			vec3 dy = dFdy( direction ) * 0.25;

			vec3 color = textureLod( envMap, equirectUv( normalize( direction - dx - dy ) ), 0.0 ).rgb;
			color += textureLod( envMap, equirectUv( normalize( direction + dx - dy ) ), 0.0 ).rgb;
			color += textureLod( envMap, equirectUv( normalize( direction - dx + dy ) ), 0.0 ).rgb;
			color += textureLod( envMap, equirectUv( normalize( direction + dx + dy ) ), 0.0 ).rgb;
			gl_FragColor = vec4( color * 0.25, 1.0 );

		}
	`)}function Wl(){return zl(`PMREMCubemapToCubemap`,{envMap:{value:null},flipEnvMap:{value:-1}},`

		varying vec3 vWorldDirection;

		uniform samplerCube envMap;
		uniform float flipEnvMap;

		void main() {

			gl_FragColor = vec4( textureCube( envMap, vec3( flipEnvMap * vWorldDirection.x, vWorldDirection.yz ) ).rgb, 1.0 );

		}
	`)}function Gl(e){let t=new WeakMap,n=new WeakMap,r=null;function i(e,t=!1){return e==null?null:t?o(e):a(e)}function a(n){if(n&&n.isTexture){let r=n.mapping;if(r===303||r===304){if(t.has(n)){let e=t.get(n).texture;return s(e,n.mapping)}{let r=n.image;if(r&&r.height>0){let i=new Ol(r.height);return i.fromEquirectangularTexture(e,n),t.set(n,i),n.addEventListener(`dispose`,l),s(i.texture,n.mapping)}return null}}}return n}function o(t){if(t&&t.isTexture&&t.isPMREMTexture!==!0){let i=t.mapping,a=i===303||i===304,o=i===301||i===302;if(a||o){let i=n.get(t),s=i===void 0?0:i.texture.pmremVersion;if(t.isRenderTargetTexture&&t.pmremVersion!==s)return r===null&&(r=new Ll(e)),i=a?r.fromEquirectangular(t,i):r.fromCubemap(t,i),i.texture.pmremVersion=t.pmremVersion,n.set(t,i),i.texture;if(i!==void 0)return i.texture;{let s=t.image;return a&&s&&s.height>0||o&&s&&c(s)?(r===null&&(r=new Ll(e)),i=a?r.fromEquirectangular(t):r.fromCubemap(t),i.texture.pmremVersion=t.pmremVersion,n.set(t,i),t.addEventListener(`dispose`,u),i.texture):null}}}return t}function s(e,t){return t===303?e.mapping=301:t===304&&(e.mapping=302),e}function c(e){let t=0;for(let n=0;n<6;n++)e[n]!==void 0&&t++;return t===6}function l(e){let n=e.target;n.removeEventListener(`dispose`,l);let r=t.get(n);r!==void 0&&(t.delete(n),r.dispose())}function u(e){let t=e.target;t.removeEventListener(`dispose`,u);let r=n.get(t);r!==void 0&&(n.delete(t),r.dispose())}function d(){t=new WeakMap,n=new WeakMap,r!==null&&(r.dispose(),r=null)}return{get:i,dispose:d}}function Kl(e){let t={};function n(n){if(t[n]!==void 0)return t[n];let r=e.getExtension(n);return t[n]=r,r}return{has:function(e){return n(e)!==null},init:function(){n(`EXT_color_buffer_float`),n(`WEBGL_clip_cull_distance`),n(`OES_texture_float_linear`),n(`EXT_color_buffer_half_float`),n(`WEBGL_multisampled_render_to_texture`),n(`WEBGL_render_shared_exponent`)},get:function(e){let t=n(e);return t===null&&Rn(`WebGLRenderer: `+e+` extension not supported.`),t}}}function ql(e,t,n,r){let i={},a=new WeakMap,o=new FinalizationRegistry(e=>delete i[e]);function s(e){c(e.target)}function c(e){e.index!==null&&t.remove(e.index);for(let n in e.attributes)t.remove(e.attributes[n]);e.removeEventListener(`dispose`,s),delete i[e.id],o.unregister(e);let c=a.get(e);c&&(t.remove(c),a.delete(e)),r.releaseStatesOfGeometry(e),e.isInstancedBufferGeometry===!0&&delete e._maxInstanceCount,n.memory.geometries--}function l(e,t){return i[t.id]===void 0&&(t.addEventListener(`dispose`,s),i[t.id]=new WeakRef(t),o.register(t,t.id,t),n.memory.geometries++),t}function u(n){let r=n.attributes;for(let n in r)t.update(r[n],e.ARRAY_BUFFER)}function d(e){let n=e.index,r=e.attributes.position,i=0;if(r===void 0)return;let o=n===null?r.array.length/3-1:n.array.length,s=new(r.count>=65535?ta:ea)(Math.ceil(o/3)*6,1),c=s.array;if(n!==null){let e=n.array;i=n.version;for(let t=0,n=0;t<o;t+=3){let r=e[t+0],i=e[t+1],a=e[t+2];c[n++]=r,c[n++]=i,c[n++]=i,c[n++]=a,c[n++]=a,c[n++]=r}}else{i=r.version;for(let e=0,t=0;e<o;e+=3){let n=e+0,r=e+1,i=e+2;c[t++]=n,c[t++]=r,c[t++]=r,c[t++]=i,c[t++]=i,c[t++]=n}}s.version=i;let l=a.get(e);l&&t.remove(l),a.set(e,s)}function f(e){let t=a.get(e);if(t){let n=e.index;n!==null&&t.version<n.version&&d(e)}else d(e);return a.get(e)}function p(){for(let e in i){let t=i[e].deref();t!==void 0&&c(t)}}return{get:l,update:u,getWireframeAttribute:f,dispose:p}}function Jl(e,t,n){let r;function i(e){r=e}let a,o;function s(e){a=e.type,o=e.bytesPerElement}function c(t,i){e.drawElements(r,i,a,t*o),n.update(i,r,1)}function l(t,i,s){s!==0&&(e.drawElementsInstanced(r,i,a,t*o,s),n.update(i,r,s))}function u(e,i,o){if(o===0)return;t.get(`WEBGL_multi_draw`).multiDrawElementsWEBGL(r,i,0,a,e,0,o);let s=0;for(let e=0;e<o;e++)s+=i[e];n.update(s,r,1)}this.setMode=i,this.setIndex=s,this.render=c,this.renderInstances=l,this.renderMultiDraw=u}function Yl(e){let t={geometries:0,textures:0},n={frame:0,calls:0,triangles:0,points:0,lines:0};function r(t,r,i){switch(n.calls++,r){case e.TRIANGLES:n.triangles+=t/3*i;break;case e.LINES:n.lines+=t/2*i;break;case e.LINE_STRIP:n.lines+=i*(t-1);break;case e.LINE_LOOP:n.lines+=i*t;break;case e.POINTS:n.points+=i*t;break;default:W(`WebGLInfo: Unknown draw mode:`,r)}}function i(){n.calls=0,n.triangles=0,n.points=0,n.lines=0}return{memory:t,render:n,programs:null,autoReset:!0,reset:i,update:r}}function Xl(e,t,n){let r=new WeakMap,i=new Nr;function a(a,o,s){let c=a.morphTargetInfluences,l=o.morphAttributes.position||o.morphAttributes.normal||o.morphAttributes.color,u=l===void 0?0:l.length,d=r.get(o);if(d===void 0||d.count!==u){d!==void 0&&d.texture.dispose();let e=o.morphAttributes.position!==void 0,n=o.morphAttributes.normal!==void 0,a=o.morphAttributes.color!==void 0,s=o.morphAttributes.position||[],c=o.morphAttributes.normal||[],l=o.morphAttributes.color||[],f=0;e===!0&&(f=1),n===!0&&(f=2),a===!0&&(f=3);let p=o.attributes.position.count*f,m=1;p>t.maxTextureSize&&(m=Math.ceil(p/t.maxTextureSize),p=t.maxTextureSize);let h=new Float32Array(p*m*4*u),g=new Ir(h,p,m,u);g.type=ht,g.needsUpdate=!0;let _=f*4;for(let t=0;t<u;t++){let r=s[t],o=c[t],u=l[t],d=p*m*4*t;for(let t=0;t<r.count;t++){let s=t*_;e===!0&&(i.fromBufferAttribute(r,t),h[d+s+0]=i.x,h[d+s+1]=i.y,h[d+s+2]=i.z,h[d+s+3]=0),n===!0&&(i.fromBufferAttribute(o,t),h[d+s+4]=i.x,h[d+s+5]=i.y,h[d+s+6]=i.z,h[d+s+7]=0),a===!0&&(i.fromBufferAttribute(u,t),h[d+s+8]=i.x,h[d+s+9]=i.y,h[d+s+10]=i.z,h[d+s+11]=u.itemSize===4?i.w:1)}}d={count:u,texture:g,size:new K(p,m)},r.set(o,d);function v(){g.dispose(),r.delete(o),o.removeEventListener(`dispose`,v)}o.addEventListener(`dispose`,v)}if(a.isInstancedMesh===!0&&a.morphTexture!==null)s.getUniforms().setValue(e,`morphTexture`,a.morphTexture,n);else{let t=0;for(let e=0;e<c.length;e++)t+=c[e];let n=o.morphTargetsRelative?1:1-t;s.getUniforms().setValue(e,`morphTargetBaseInfluence`,n),s.getUniforms().setValue(e,`morphTargetInfluences`,c)}s.getUniforms().setValue(e,`morphTargetsTexture`,d.texture,n),s.getUniforms().setValue(e,`morphTargetsTextureSize`,d.size)}return{update:a}}function Zl(e,t,n,r,i){let a=new WeakMap;function o(r){let o=i.render.frame,s=r.geometry,l=t.get(r,s);if(a.get(l)!==o&&(t.update(l),a.set(l,o)),r.isInstancedMesh&&(r.hasEventListener(`dispose`,c)===!1&&r.addEventListener(`dispose`,c),a.get(r)!==o&&(n.update(r.instanceMatrix,e.ARRAY_BUFFER),r.instanceColor!==null&&n.update(r.instanceColor,e.ARRAY_BUFFER),a.set(r,o))),r.isSkinnedMesh){let e=r.skeleton;a.get(e)!==o&&(e.update(),a.set(e,o))}return l}function s(){a=new WeakMap}function c(e){let t=e.target;t.removeEventListener(`dispose`,c),r.releaseStatesOfObject(t),n.remove(t.instanceMatrix),t.instanceColor!==null&&n.remove(t.instanceColor)}return{update:o,dispose:s}}var Ql={1:`LINEAR_TONE_MAPPING`,2:`REINHARD_TONE_MAPPING`,3:`CINEON_TONE_MAPPING`,4:`ACES_FILMIC_TONE_MAPPING`,6:`AGX_TONE_MAPPING`,7:`NEUTRAL_TONE_MAPPING`,5:`CUSTOM_TONE_MAPPING`};function $l(e,t,n,r,i,a){let o=new Fr(t,n,{type:e,depthBuffer:i,stencilBuffer:a,samples:r?4:0,storeMultisampledDepthBuffer:!1,storeMultisampledStencilBuffer:!1,resolveDepthBuffer:!1,resolveStencilBuffer:!1}),s=null,c=null,l=null,u=new ma;u.setAttribute(`position`,new na([-1,3,0,-1,-1,0,3,-1,0],3)),u.setAttribute(`uv`,new na([0,2,0,0,2,0],2));let d=new dc({uniforms:{tDiffuse:{value:null}},vertexShader:`
			precision highp float;

			uniform mat4 modelViewMatrix;
			uniform mat4 projectionMatrix;

			attribute vec3 position;
			attribute vec2 uv;

			varying vec2 vUv;

			void main() {
				vUv = uv;
				gl_Position = projectionMatrix * modelViewMatrix * vec4( position, 1.0 );
			}`,fragmentShader:`
			precision highp float;

			uniform sampler2D tDiffuse;

			varying vec2 vUv;

			#include <tonemapping_pars_fragment>
			#include <colorspace_pars_fragment>

			void main() {
				gl_FragColor = texture2D( tDiffuse, vUv );

				#ifdef LINEAR_TONE_MAPPING
					gl_FragColor.rgb = LinearToneMapping( gl_FragColor.rgb );
				#elif defined( REINHARD_TONE_MAPPING )
					gl_FragColor.rgb = ReinhardToneMapping( gl_FragColor.rgb );
				#elif defined( CINEON_TONE_MAPPING )
					gl_FragColor.rgb = CineonToneMapping( gl_FragColor.rgb );
				#elif defined( ACES_FILMIC_TONE_MAPPING )
					gl_FragColor.rgb = ACESFilmicToneMapping( gl_FragColor.rgb );
				#elif defined( AGX_TONE_MAPPING )
					gl_FragColor.rgb = AgXToneMapping( gl_FragColor.rgb );
				#elif defined( NEUTRAL_TONE_MAPPING )
					gl_FragColor.rgb = NeutralToneMapping( gl_FragColor.rgb );
				#elif defined( CUSTOM_TONE_MAPPING )
					gl_FragColor.rgb = CustomToneMapping( gl_FragColor.rgb );
				#endif

				#ifdef SRGB_TRANSFER
					gl_FragColor = sRGBTransferOETF( gl_FragColor );
				#endif
			}`,depthTest:!1,depthWrite:!1}),f=new Ha(u,d),p=new Hc(-1,1,1,-1,0,1),m=null,h=null,g=!1,_,v=null,y=[],b=!1;this.setSize=function(e,t){o.setSize(e,t),s!==null&&s.setSize(e,t),c!==null&&c.setSize(e,t);for(let n=0;n<y.length;n++){let r=y[n];r.setSize&&r.setSize(e,t)}},this.setEffects=function(e){y=e,b=y.length>0&&y[0].isRenderPass===!0;let t=o.width,n=o.height;y.length>0&&s===null&&(s=new Fr(t,n,{type:gt,depthBuffer:!1,stencilBuffer:!1}),c=new Fr(t,n,{type:gt,depthBuffer:!1,stencilBuffer:!1}));let r=i===!0&&y.some(e=>e.needsDepthTexture===!0);r!==(o.depthTexture!==null)&&(r===!0&&l===null&&(l=new jo(t,n),a===!0&&(l.format=Et,l.type=yt)),o.dispose(),o.depthTexture=r?l:null,o.resolveDepthBuffer=r,o.storeMultisampledDepthBuffer=r);for(let e=0;e<y.length;e++){let i=y[e];i.setSize&&i.setSize(t,n),r&&i.needsDepthTexture===!0&&i.setDepthTexture&&i.setDepthTexture(l)}},this.begin=function(e,t){if(g||e.toneMapping===0&&y.length===0)return!1;if(v=t,t!==null){let e=t.width,n=t.height;(o.width!==e||o.height!==n)&&this.setSize(e,n)}return b===!1&&e.setRenderTarget(o),_=e.toneMapping,e.toneMapping=0,!0},this.hasRenderPass=function(){return b},this.end=function(e,t){e.toneMapping=_,g=!0;let n=o,r=s;for(let i=0;i<y.length;i++){let a=y[i];a.enabled!==!1&&(a.render(e,r,n,t),a.needsSwap!==!1&&(n=r,r=r===s?c:s))}if(m!==e.outputColorSpace||h!==e.toneMapping){m=e.outputColorSpace,h=e.toneMapping,d.defines={},Sr.getTransfer(m)===`srgb`&&(d.defines.SRGB_TRANSFER=``);let t=Ql[h];t&&(d.defines[t]=``),d.needsUpdate=!0}d.uniforms.tDiffuse.value=n.texture,e.setRenderTarget(v),e.render(f,p),v=null,g=!1},this.isCompositing=function(){return g},this.dispose=function(){o.dispose(),s!==null&&s.dispose(),c!==null&&c.dispose(),u.dispose(),d.dispose()}}var eu=new Mr,tu=new jo(1,1),nu=new Mo(1),ru=new Ir,iu=new Lr,au=new ko,ou=[],su=[],cu=new Float32Array(16),lu=new Float32Array(9),uu=new Float32Array(4);function du(e,t,n){let r=e[0];if(r<=0||r>0)return e;let i=t*n,a=ou[i];if(a===void 0&&(a=new Float32Array(i),ou[i]=a),t!==0){r.toArray(a,0);for(let r=1,i=0;r!==t;++r)i+=n,e[r].toArray(a,i)}return a}function fu(e,t){if(e.length!==t.length)return!1;for(let n=0,r=e.length;n<r;n++)if(e[n]!==t[n])return!1;return!0}function pu(e,t){for(let n=0,r=t.length;n<r;n++)e[n]=t[n]}function mu(e,t){let n=su[t];n===void 0&&(n=new Int32Array(t),su[t]=n);for(let r=0;r!==t;++r)n[r]=e.allocateTextureUnit();return n}function hu(e,t){let n=this.cache;n[0]!==t&&(e.uniform1f(this.addr,t),n[0]=t)}function gu(e,t){let n=this.cache;if(t.x!==void 0)(n[0]!==t.x||n[1]!==t.y)&&(e.uniform2f(this.addr,t.x,t.y),n[0]=t.x,n[1]=t.y);else{if(fu(n,t))return;e.uniform2fv(this.addr,t),pu(n,t)}}function _u(e,t){let n=this.cache;if(t.x!==void 0)(n[0]!==t.x||n[1]!==t.y||n[2]!==t.z)&&(e.uniform3f(this.addr,t.x,t.y,t.z),n[0]=t.x,n[1]=t.y,n[2]=t.z);else if(t.r!==void 0)(n[0]!==t.r||n[1]!==t.g||n[2]!==t.b)&&(e.uniform3f(this.addr,t.r,t.g,t.b),n[0]=t.r,n[1]=t.g,n[2]=t.b);else{if(fu(n,t))return;e.uniform3fv(this.addr,t),pu(n,t)}}function vu(e,t){let n=this.cache;if(t.x!==void 0)(n[0]!==t.x||n[1]!==t.y||n[2]!==t.z||n[3]!==t.w)&&(e.uniform4f(this.addr,t.x,t.y,t.z,t.w),n[0]=t.x,n[1]=t.y,n[2]=t.z,n[3]=t.w);else{if(fu(n,t))return;e.uniform4fv(this.addr,t),pu(n,t)}}function yu(e,t){let n=this.cache,r=t.elements;if(r===void 0){if(fu(n,t))return;e.uniformMatrix2fv(this.addr,!1,t),pu(n,t)}else{if(fu(n,r))return;uu.set(r),e.uniformMatrix2fv(this.addr,!1,uu),pu(n,r)}}function bu(e,t){let n=this.cache,r=t.elements;if(r===void 0){if(fu(n,t))return;e.uniformMatrix3fv(this.addr,!1,t),pu(n,t)}else{if(fu(n,r))return;lu.set(r),e.uniformMatrix3fv(this.addr,!1,lu),pu(n,r)}}function xu(e,t){let n=this.cache,r=t.elements;if(r===void 0){if(fu(n,t))return;e.uniformMatrix4fv(this.addr,!1,t),pu(n,t)}else{if(fu(n,r))return;cu.set(r),e.uniformMatrix4fv(this.addr,!1,cu),pu(n,r)}}function Su(e,t){let n=this.cache;n[0]!==t&&(e.uniform1i(this.addr,t),n[0]=t)}function Cu(e,t){let n=this.cache;if(t.x!==void 0)(n[0]!==t.x||n[1]!==t.y)&&(e.uniform2i(this.addr,t.x,t.y),n[0]=t.x,n[1]=t.y);else{if(fu(n,t))return;e.uniform2iv(this.addr,t),pu(n,t)}}function wu(e,t){let n=this.cache;if(t.x!==void 0)(n[0]!==t.x||n[1]!==t.y||n[2]!==t.z)&&(e.uniform3i(this.addr,t.x,t.y,t.z),n[0]=t.x,n[1]=t.y,n[2]=t.z);else{if(fu(n,t))return;e.uniform3iv(this.addr,t),pu(n,t)}}function Tu(e,t){let n=this.cache;if(t.x!==void 0)(n[0]!==t.x||n[1]!==t.y||n[2]!==t.z||n[3]!==t.w)&&(e.uniform4i(this.addr,t.x,t.y,t.z,t.w),n[0]=t.x,n[1]=t.y,n[2]=t.z,n[3]=t.w);else{if(fu(n,t))return;e.uniform4iv(this.addr,t),pu(n,t)}}function Eu(e,t){let n=this.cache;n[0]!==t&&(e.uniform1ui(this.addr,t),n[0]=t)}function Du(e,t){let n=this.cache;if(t.x!==void 0)(n[0]!==t.x||n[1]!==t.y)&&(e.uniform2ui(this.addr,t.x,t.y),n[0]=t.x,n[1]=t.y);else{if(fu(n,t))return;e.uniform2uiv(this.addr,t),pu(n,t)}}function Ou(e,t){let n=this.cache;if(t.x!==void 0)(n[0]!==t.x||n[1]!==t.y||n[2]!==t.z)&&(e.uniform3ui(this.addr,t.x,t.y,t.z),n[0]=t.x,n[1]=t.y,n[2]=t.z);else{if(fu(n,t))return;e.uniform3uiv(this.addr,t),pu(n,t)}}function ku(e,t){let n=this.cache;if(t.x!==void 0)(n[0]!==t.x||n[1]!==t.y||n[2]!==t.z||n[3]!==t.w)&&(e.uniform4ui(this.addr,t.x,t.y,t.z,t.w),n[0]=t.x,n[1]=t.y,n[2]=t.z,n[3]=t.w);else{if(fu(n,t))return;e.uniform4uiv(this.addr,t),pu(n,t)}}function Au(e){return e.version===0&&(e.compareFunction=519,e.needsUpdate=!0),e}function ju(e,t,n){let r=this.cache,i=n.allocateTextureUnit();r[0]!==i&&(e.uniform1i(this.addr,i),r[0]=i);let a;a=this.type===e.SAMPLER_2D_SHADOW?Au(tu):eu,n.setTexture2D(t||a,i)}function Mu(e,t,n){let r=this.cache,i=n.allocateTextureUnit();r[0]!==i&&(e.uniform1i(this.addr,i),r[0]=i),n.setTexture3D(t||iu,i)}function Nu(e,t,n){let r=this.cache,i=n.allocateTextureUnit();r[0]!==i&&(e.uniform1i(this.addr,i),r[0]=i);let a;a=this.type===e.SAMPLER_CUBE_SHADOW?Au(nu):au,n.setTextureCube(t||a,i)}function Pu(e,t,n){let r=this.cache,i=n.allocateTextureUnit();r[0]!==i&&(e.uniform1i(this.addr,i),r[0]=i),n.setTexture2DArray(t||ru,i)}function Fu(e){switch(e){case 5126:return hu;case 35664:return gu;case 35665:return _u;case 35666:return vu;case 35674:return yu;case 35675:return bu;case 35676:return xu;case 5124:case 35670:return Su;case 35667:case 35671:return Cu;case 35668:case 35672:return wu;case 35669:case 35673:return Tu;case 5125:return Eu;case 36294:return Du;case 36295:return Ou;case 36296:return ku;case 35678:case 36198:case 36298:case 36306:case 35682:return ju;case 35679:case 36299:case 36307:return Mu;case 35680:case 36300:case 36308:case 36293:return Nu;case 36289:case 36303:case 36311:case 36292:return Pu}}function Iu(e,t){e.uniform1fv(this.addr,t)}function Lu(e,t){let n=du(t,this.size,2);e.uniform2fv(this.addr,n)}function Ru(e,t){let n=du(t,this.size,3);e.uniform3fv(this.addr,n)}function zu(e,t){let n=du(t,this.size,4);e.uniform4fv(this.addr,n)}function Bu(e,t){let n=du(t,this.size,4);e.uniformMatrix2fv(this.addr,!1,n)}function Vu(e,t){let n=du(t,this.size,9);e.uniformMatrix3fv(this.addr,!1,n)}function Hu(e,t){let n=du(t,this.size,16);e.uniformMatrix4fv(this.addr,!1,n)}function Uu(e,t){e.uniform1iv(this.addr,t)}function Wu(e,t){e.uniform2iv(this.addr,t)}function Gu(e,t){e.uniform3iv(this.addr,t)}function Ku(e,t){e.uniform4iv(this.addr,t)}function qu(e,t){e.uniform1uiv(this.addr,t)}function Ju(e,t){e.uniform2uiv(this.addr,t)}function Yu(e,t){e.uniform3uiv(this.addr,t)}function Xu(e,t){e.uniform4uiv(this.addr,t)}function Zu(e,t,n){let r=this.cache,i=t.length,a=mu(n,i);fu(r,a)||(e.uniform1iv(this.addr,a),pu(r,a));let o;o=this.type===e.SAMPLER_2D_SHADOW?Au(tu):eu;for(let e=0;e!==i;++e)n.setTexture2D(t[e]||o,a[e])}function Qu(e,t,n){let r=this.cache,i=t.length,a=mu(n,i);fu(r,a)||(e.uniform1iv(this.addr,a),pu(r,a));for(let e=0;e!==i;++e)n.setTexture3D(t[e]||iu,a[e])}function $u(e,t,n){let r=this.cache,i=t.length,a=mu(n,i);fu(r,a)||(e.uniform1iv(this.addr,a),pu(r,a));let o;o=this.type===e.SAMPLER_CUBE_SHADOW?Au(nu):au;for(let e=0;e!==i;++e)n.setTextureCube(t[e]||o,a[e])}function ed(e,t,n){let r=this.cache,i=t.length,a=mu(n,i);fu(r,a)||(e.uniform1iv(this.addr,a),pu(r,a));for(let e=0;e!==i;++e)n.setTexture2DArray(t[e]||ru,a[e])}function td(e){switch(e){case 5126:return Iu;case 35664:return Lu;case 35665:return Ru;case 35666:return zu;case 35674:return Bu;case 35675:return Vu;case 35676:return Hu;case 5124:case 35670:return Uu;case 35667:case 35671:return Wu;case 35668:case 35672:return Gu;case 35669:case 35673:return Ku;case 5125:return qu;case 36294:return Ju;case 36295:return Yu;case 36296:return Xu;case 35678:case 36198:case 36298:case 36306:case 35682:return Zu;case 35679:case 36299:case 36307:return Qu;case 35680:case 36300:case 36308:case 36293:return $u;case 36289:case 36303:case 36311:case 36292:return ed}}var nd=class{constructor(e,t,n){this.id=e,this.addr=n,this.cache=[],this.type=t.type,this.setValue=Fu(t.type)}},rd=class{constructor(e,t,n){this.id=e,this.addr=n,this.cache=[],this.type=t.type,this.size=t.size,this.setValue=td(t.type)}},id=class{constructor(e){this.id=e,this.seq=[],this.map={}}setValue(e,t,n){let r=this.seq;for(let i=0,a=r.length;i!==a;++i){let a=r[i];a.setValue(e,t[a.id],n)}}},ad=/(\w+)(\])?(\[|\.)?/g;function od(e,t){e.seq.push(t),e.map[t.id]=t}function sd(e,t,n){let r=e.name,i=r.length;for(ad.lastIndex=0;;){let a=ad.exec(r),o=ad.lastIndex,s=a[1],c=a[2]===`]`,l=a[3];if(c&&(s|=0),l===void 0||l===`[`&&o+2===i){od(n,l===void 0?new nd(s,e,t):new rd(s,e,t));break}{let e=n.map[s];e===void 0&&(e=new id(s),od(n,e)),n=e}}}var cd=class{constructor(e,t){this.seq=[],this.map={};let n=e.getProgramParameter(t,e.ACTIVE_UNIFORMS);for(let r=0;r<n;++r){let n=e.getActiveUniform(t,r);sd(n,e.getUniformLocation(t,n.name),this)}let r=[],i=[];for(let t of this.seq)t.type===e.SAMPLER_2D_SHADOW||t.type===e.SAMPLER_CUBE_SHADOW||t.type===e.SAMPLER_2D_ARRAY_SHADOW?r.push(t):i.push(t);r.length>0&&(this.seq=r.concat(i))}setValue(e,t,n,r){let i=this.map[t];i!==void 0&&i.setValue(e,n,r)}setOptional(e,t,n){let r=t[n];r!==void 0&&this.setValue(e,n,r)}static upload(e,t,n,r){for(let i=0,a=t.length;i!==a;++i){let a=t[i],o=n[a.id];o.needsUpdate!==!1&&a.setValue(e,o.value,r)}}static seqWithValue(e,t){let n=[];for(let r=0,i=e.length;r!==i;++r){let i=e[r];i.id in t&&n.push(i)}return n}};function ld(e,t,n){let r=e.createShader(t);return e.shaderSource(r,n),e.compileShader(r),r}var ud=37297,dd=0;function fd(e,t){let n=e.split(`
`),r=[],i=Math.max(t-6,0),a=Math.min(t+6,n.length);for(let e=i;e<a;e++){let i=e+1;r.push(`${i===t?`>`:` `} ${i}: ${n[e]}`)}return r.join(`
`)}var pd=new J;function md(e){Sr._getMatrix(pd,Sr.workingColorSpace,e);let t=`mat3( ${pd.elements.map(e=>e.toFixed(4))} )`;switch(Sr.getTransfer(e)){case Tn:return[t,`LinearTransferOETF`];case En:return[t,`sRGBTransferOETF`];default:return U(`WebGLProgram: Unsupported color space: `,e),[t,`LinearTransferOETF`]}}function hd(e,t,n){let r=e.getShaderParameter(t,e.COMPILE_STATUS),i=(e.getShaderInfoLog(t)||``).trim();if(r&&i===``)return``;let a=/ERROR: 0:(\d+)/.exec(i);if(a){let r=parseInt(a[1]);return n.toUpperCase()+`

`+i+`

`+fd(e.getShaderSource(t),r)}return i}function gd(e,t){let n=md(t);return[`vec4 ${e}( vec4 value ) {`,`	return ${n[1]}( vec4( ${n[0]} * value.rgb, value.a ) );`,`}`].join(`
`)}var _d={1:`Linear`,2:`Reinhard`,3:`Cineon`,4:`ACESFilmic`,6:`AgX`,7:`Neutral`,5:`Custom`};function vd(e,t){let n=_d[t];return n===void 0?(U(`WebGLProgram: Unsupported toneMapping:`,t),`vec3 `+e+`( vec3 color ) { return LinearToneMapping( color ); }`):`vec3 `+e+`( vec3 color ) { return `+n+`ToneMapping( color ); }`}var yd=new q;function bd(){return Sr.getLuminanceCoefficients(yd),[`float luminance( const in vec3 rgb ) {`,`	const vec3 weights = vec3( ${yd.x.toFixed(4)}, ${yd.y.toFixed(4)}, ${yd.z.toFixed(4)} );`,`	return dot( weights, rgb );`,`}`].join(`
`)}function xd(e){return[e.extensionClipCullDistance?`#extension GL_ANGLE_clip_cull_distance : require`:``,e.extensionMultiDraw?`#extension GL_ANGLE_multi_draw : require`:``].filter(wd).join(`
`)}function Sd(e){let t=[];for(let n in e){let r=e[n];r!==!1&&t.push(`#define `+n+` `+r)}return t.join(`
`)}function Cd(e,t){let n={},r=e.getProgramParameter(t,e.ACTIVE_ATTRIBUTES);for(let i=0;i<r;i++){let r=e.getActiveAttrib(t,i),a=r.name,o=1;r.type===e.FLOAT_MAT2&&(o=2),r.type===e.FLOAT_MAT3&&(o=3),r.type===e.FLOAT_MAT4&&(o=4),n[a]={type:r.type,location:e.getAttribLocation(t,a),locationSize:o}}return n}function wd(e){return e!==``}function Td(e,t){let n=t.numSpotLightShadows+t.numSpotLightMaps-t.numSpotLightShadowsWithMaps;return e.replace(/NUM_SUN_LIGHTS/g,t.numSunLights).replace(/NUM_DIR_LIGHTS/g,t.numDirLights).replace(/NUM_SPOT_LIGHTS/g,t.numSpotLights).replace(/NUM_SPOT_LIGHT_MAPS/g,t.numSpotLightMaps).replace(/NUM_SPOT_LIGHT_COORDS/g,n).replace(/NUM_RECT_AREA_LIGHTS/g,t.numRectAreaLights).replace(/NUM_POINT_LIGHTS/g,t.numPointLights).replace(/NUM_HEMI_LIGHTS/g,t.numHemiLights).replace(/NUM_SUN_LIGHT_SHADOWS/g,t.numSunLightShadows).replace(/NUM_DIR_LIGHT_SHADOWS/g,t.numDirLightShadows).replace(/NUM_SPOT_LIGHT_SHADOWS_WITH_MAPS/g,t.numSpotLightShadowsWithMaps).replace(/NUM_SPOT_LIGHT_SHADOWS/g,t.numSpotLightShadows).replace(/NUM_POINT_LIGHT_SHADOWS/g,t.numPointLightShadows).replace(/NUM_LIGHT_PROBE_GRIDS/g,t.numLightProbeGrids)}function Ed(e,t){return e.replace(/NUM_CLIPPING_PLANES/g,t.numClippingPlanes).replace(/UNION_CLIPPING_PLANES/g,t.numClippingPlanes-t.numClipIntersection)}var Dd=/^[ \t]*#include +<([\w\d./]+)>/gm;function Od(e){return e.replace(Dd,kd)}function kd(e,t){let n=X[t];if(n===void 0)throw Error(`THREE.WebGLProgram: Can not resolve #include <`+t+`>`);return Od(n)}var Ad=/#pragma unroll_loop_start\s+for\s*\(\s*int\s+i\s*=\s*(\d+)\s*;\s*i\s*<\s*(\d+)\s*;\s*i\s*\+\+\s*\)\s*{([\s\S]+?)}\s+#pragma unroll_loop_end/g;function jd(e){return e.replace(Ad,Md)}function Md(e,t,n,r){let i=``;for(let e=parseInt(t);e<parseInt(n);e++)i+=r.replace(/\[\s*i\s*\]/g,`[ `+e+` ]`).replace(/UNROLLED_LOOP_INDEX/g,e);return i}function Nd(e){let t=`precision ${e.precision} float;
	precision ${e.precision} int;
	precision ${e.precision} sampler2D;
	precision ${e.precision} samplerCube;
	precision ${e.precision} sampler3D;
	precision ${e.precision} sampler2DArray;
	precision ${e.precision} sampler2DShadow;
	precision ${e.precision} samplerCubeShadow;
	precision ${e.precision} sampler2DArrayShadow;
	precision ${e.precision} isampler2D;
	precision ${e.precision} isampler3D;
	precision ${e.precision} isamplerCube;
	precision ${e.precision} isampler2DArray;
	precision ${e.precision} usampler2D;
	precision ${e.precision} usampler3D;
	precision ${e.precision} usamplerCube;
	precision ${e.precision} usampler2DArray;
	`;return e.precision===`highp`?t+=`
#define HIGH_PRECISION`:e.precision===`mediump`?t+=`
#define MEDIUM_PRECISION`:e.precision===`lowp`&&(t+=`
#define LOW_PRECISION`),t}var Pd={1:`SHADOWMAP_TYPE_PCF`,3:`SHADOWMAP_TYPE_VSM`};function Fd(e){return Pd[e.shadowMapType]||`SHADOWMAP_TYPE_BASIC`}var Id={302:`ENVMAP_MODE_REFRACTION`};function Ld(e){return e.envMap===!1?`ENVMAP_MODE_REFLECTION`:Id[e.envMapMode]||`ENVMAP_MODE_REFLECTION`}var Rd={0:`ENVMAP_BLENDING_MULTIPLY`,1:`ENVMAP_BLENDING_MIX`,2:`ENVMAP_BLENDING_ADD`};function zd(e){return e.envMap===!1?`ENVMAP_BLENDING_NONE`:Rd[e.combine]||`ENVMAP_BLENDING_NONE`}function Bd(e,t,n,r){let i=e.getContext(),a=n.defines,o=n.vertexShader,s=n.fragmentShader,c=Fd(n),l=n.envMapPMREM===!0?`ENVMAP_TYPE_PMREM`:`ENVMAP_TYPE_CUBE`,u=Ld(n),d=zd(n),f=xd(n),p=Sd(a),m=i.createProgram(),h,g,_=n.glslVersion?`#version `+n.glslVersion+`
`:``;n.isRawShaderMaterial?(h=[`#define SHADER_TYPE `+n.shaderType,`#define SHADER_NAME `+n.shaderName,p].filter(wd).join(`
`),h.length>0&&(h+=`
`),g=[`#define SHADER_TYPE `+n.shaderType,`#define SHADER_NAME `+n.shaderName,p].filter(wd).join(`
`),g.length>0&&(g+=`
`)):(h=[Nd(n),`#define SHADER_TYPE `+n.shaderType,`#define SHADER_NAME `+n.shaderName,p,n.extensionClipCullDistance?`#define USE_CLIP_DISTANCE`:``,n.batching?`#define USE_BATCHING`:``,n.batchingColor?`#define USE_BATCHING_COLOR`:``,n.instancing?`#define USE_INSTANCING`:``,n.instancingColor?`#define USE_INSTANCING_COLOR`:``,n.instancingMorph?`#define USE_INSTANCING_MORPH`:``,n.useFog&&n.fog?`#define USE_FOG`:``,n.useFog&&n.fogExp2?`#define FOG_EXP2`:``,n.map?`#define USE_MAP`:``,n.envMap?`#define USE_ENVMAP`:``,n.envMap?`#define `+u:``,n.lightMap?`#define USE_LIGHTMAP`:``,n.aoMap?`#define USE_AOMAP`:``,n.bumpMap?`#define USE_BUMPMAP`:``,n.normalMap?`#define USE_NORMALMAP`:``,n.normalMapObjectSpace?`#define USE_NORMALMAP_OBJECTSPACE`:``,n.normalMapTangentSpace?`#define USE_NORMALMAP_TANGENTSPACE`:``,n.displacementMap?`#define USE_DISPLACEMENTMAP`:``,n.emissiveMap?`#define USE_EMISSIVEMAP`:``,n.anisotropy?`#define USE_ANISOTROPY`:``,n.anisotropyMap?`#define USE_ANISOTROPYMAP`:``,n.clearcoatMap?`#define USE_CLEARCOATMAP`:``,n.clearcoatRoughnessMap?`#define USE_CLEARCOAT_ROUGHNESSMAP`:``,n.clearcoatNormalMap?`#define USE_CLEARCOAT_NORMALMAP`:``,n.diffuseRoughnessMap?`#define USE_DIFFUSE_ROUGHNESSMAP`:``,n.iridescenceMap?`#define USE_IRIDESCENCEMAP`:``,n.iridescenceThicknessMap?`#define USE_IRIDESCENCE_THICKNESSMAP`:``,n.specularMap?`#define USE_SPECULARMAP`:``,n.specularColorMap?`#define USE_SPECULAR_COLORMAP`:``,n.specularIntensityMap?`#define USE_SPECULAR_INTENSITYMAP`:``,n.roughnessMap?`#define USE_ROUGHNESSMAP`:``,n.metalnessMap?`#define USE_METALNESSMAP`:``,n.alphaMap?`#define USE_ALPHAMAP`:``,n.alphaHash?`#define USE_ALPHAHASH`:``,n.transmission?`#define USE_TRANSMISSION`:``,n.transmissionMap?`#define USE_TRANSMISSIONMAP`:``,n.thicknessMap?`#define USE_THICKNESSMAP`:``,n.sheenColorMap?`#define USE_SHEEN_COLORMAP`:``,n.sheenRoughnessMap?`#define USE_SHEEN_ROUGHNESSMAP`:``,n.mapUv?`#define MAP_UV `+n.mapUv:``,n.alphaMapUv?`#define ALPHAMAP_UV `+n.alphaMapUv:``,n.lightMapUv?`#define LIGHTMAP_UV `+n.lightMapUv:``,n.aoMapUv?`#define AOMAP_UV `+n.aoMapUv:``,n.emissiveMapUv?`#define EMISSIVEMAP_UV `+n.emissiveMapUv:``,n.bumpMapUv?`#define BUMPMAP_UV `+n.bumpMapUv:``,n.normalMapUv?`#define NORMALMAP_UV `+n.normalMapUv:``,n.displacementMapUv?`#define DISPLACEMENTMAP_UV `+n.displacementMapUv:``,n.metalnessMapUv?`#define METALNESSMAP_UV `+n.metalnessMapUv:``,n.roughnessMapUv?`#define ROUGHNESSMAP_UV `+n.roughnessMapUv:``,n.anisotropyMapUv?`#define ANISOTROPYMAP_UV `+n.anisotropyMapUv:``,n.clearcoatMapUv?`#define CLEARCOATMAP_UV `+n.clearcoatMapUv:``,n.clearcoatNormalMapUv?`#define CLEARCOAT_NORMALMAP_UV `+n.clearcoatNormalMapUv:``,n.clearcoatRoughnessMapUv?`#define CLEARCOAT_ROUGHNESSMAP_UV `+n.clearcoatRoughnessMapUv:``,n.diffuseRoughnessMapUv?`#define DIFFUSE_ROUGHNESSMAP_UV `+n.diffuseRoughnessMapUv:``,n.iridescenceMapUv?`#define IRIDESCENCEMAP_UV `+n.iridescenceMapUv:``,n.iridescenceThicknessMapUv?`#define IRIDESCENCE_THICKNESSMAP_UV `+n.iridescenceThicknessMapUv:``,n.sheenColorMapUv?`#define SHEEN_COLORMAP_UV `+n.sheenColorMapUv:``,n.sheenRoughnessMapUv?`#define SHEEN_ROUGHNESSMAP_UV `+n.sheenRoughnessMapUv:``,n.specularMapUv?`#define SPECULARMAP_UV `+n.specularMapUv:``,n.specularColorMapUv?`#define SPECULAR_COLORMAP_UV `+n.specularColorMapUv:``,n.specularIntensityMapUv?`#define SPECULAR_INTENSITYMAP_UV `+n.specularIntensityMapUv:``,n.transmissionMapUv?`#define TRANSMISSIONMAP_UV `+n.transmissionMapUv:``,n.thicknessMapUv?`#define THICKNESSMAP_UV `+n.thicknessMapUv:``,n.vertexTangents&&n.flatShading===!1?`#define USE_TANGENT`:``,n.vertexNormals?`#define HAS_NORMAL`:``,n.vertexColors?`#define USE_COLOR`:``,n.vertexAlphas?`#define USE_COLOR_ALPHA`:``,n.vertexUv1s?`#define USE_UV1`:``,n.vertexUv2s?`#define USE_UV2`:``,n.vertexUv3s?`#define USE_UV3`:``,n.pointsUvs?`#define USE_POINTS_UV`:``,n.flatShading?`#define FLAT_SHADED`:``,n.skinning?`#define USE_SKINNING`:``,n.morphTargets?`#define USE_MORPHTARGETS`:``,n.morphNormals&&n.flatShading===!1?`#define USE_MORPHNORMALS`:``,n.morphColors?`#define USE_MORPHCOLORS`:``,n.morphTargetsCount>0?`#define MORPHTARGETS_TEXTURE_STRIDE `+n.morphTextureStride:``,n.morphTargetsCount>0?`#define MORPHTARGETS_COUNT `+n.morphTargetsCount:``,n.doubleSided?`#define DOUBLE_SIDED`:``,n.flipSided?`#define FLIP_SIDED`:``,n.shadowMapEnabled?`#define USE_SHADOWMAP`:``,n.shadowMapEnabled?`#define `+c:``,n.sizeAttenuation?`#define USE_SIZEATTENUATION`:``,n.numLightProbes>0?`#define USE_LIGHT_PROBES`:``,n.logarithmicDepthBuffer?`#define USE_LOGARITHMIC_DEPTH_BUFFER`:``,n.reversedDepthBuffer?`#define USE_REVERSED_DEPTH_BUFFER`:``,`uniform mat4 modelMatrix;`,`uniform mat4 modelViewMatrix;`,`uniform mat4 projectionMatrix;`,`uniform mat4 viewMatrix;`,`uniform mat3 normalMatrix;`,`uniform vec3 cameraPosition;`,`uniform bool isOrthographic;`,`#ifdef USE_INSTANCING`,`	attribute mat4 instanceMatrix;`,`#endif`,`#ifdef USE_INSTANCING_COLOR`,`	attribute vec3 instanceColor;`,`#endif`,`#ifdef USE_INSTANCING_MORPH`,`	uniform sampler2D morphTexture;`,`#endif`,`attribute vec3 position;`,`attribute vec3 normal;`,`attribute vec2 uv;`,`#ifdef USE_UV1`,`	attribute vec2 uv1;`,`#endif`,`#ifdef USE_UV2`,`	attribute vec2 uv2;`,`#endif`,`#ifdef USE_UV3`,`	attribute vec2 uv3;`,`#endif`,`#ifdef USE_TANGENT`,`	attribute vec4 tangent;`,`#endif`,`#if defined( USE_COLOR_ALPHA )`,`	attribute vec4 color;`,`#elif defined( USE_COLOR )`,`	attribute vec3 color;`,`#endif`,`#ifdef USE_SKINNING`,`	attribute vec4 skinIndex;`,`	attribute vec4 skinWeight;`,`#endif`,`
`].filter(wd).join(`
`),g=[Nd(n),`#define SHADER_TYPE `+n.shaderType,`#define SHADER_NAME `+n.shaderName,p,n.useFog&&n.fog?`#define USE_FOG`:``,n.useFog&&n.fogExp2?`#define FOG_EXP2`:``,n.alphaToCoverage?`#define ALPHA_TO_COVERAGE`:``,n.map?`#define USE_MAP`:``,n.matcap?`#define USE_MATCAP`:``,n.envMap?`#define USE_ENVMAP`:``,n.envMap?`#define `+l:``,n.envMap?`#define `+u:``,n.envMap?`#define `+d:``,n.envMapPMREM?`#define ENVMAP_MAX_LOD `+n.envMapMaxLod+`.0`:``,n.envMapPMREM?`#define ENVMAP_SIZE `+n.envMapSize+`.0`:``,n.lightMap?`#define USE_LIGHTMAP`:``,n.aoMap?`#define USE_AOMAP`:``,n.bumpMap?`#define USE_BUMPMAP`:``,n.normalMap?`#define USE_NORMALMAP`:``,n.normalMapObjectSpace?`#define USE_NORMALMAP_OBJECTSPACE`:``,n.normalMapTangentSpace?`#define USE_NORMALMAP_TANGENTSPACE`:``,n.packedNormalMap?`#define USE_PACKED_NORMALMAP`:``,n.emissiveMap?`#define USE_EMISSIVEMAP`:``,n.anisotropy?`#define USE_ANISOTROPY`:``,n.anisotropyMap?`#define USE_ANISOTROPYMAP`:``,n.clearcoat?`#define USE_CLEARCOAT`:``,n.clearcoatMap?`#define USE_CLEARCOATMAP`:``,n.clearcoatRoughnessMap?`#define USE_CLEARCOAT_ROUGHNESSMAP`:``,n.clearcoatNormalMap?`#define USE_CLEARCOAT_NORMALMAP`:``,n.diffuseRoughness?`#define USE_DIFFUSE_ROUGHNESS`:``,n.diffuseRoughnessMap?`#define USE_DIFFUSE_ROUGHNESSMAP`:``,n.dispersion?`#define USE_DISPERSION`:``,n.retroreflection?`#define USE_RETROREFLECTION`:``,n.iridescence?`#define USE_IRIDESCENCE`:``,n.iridescenceMap?`#define USE_IRIDESCENCEMAP`:``,n.iridescenceThicknessMap?`#define USE_IRIDESCENCE_THICKNESSMAP`:``,n.specularMap?`#define USE_SPECULARMAP`:``,n.specularColorMap?`#define USE_SPECULAR_COLORMAP`:``,n.specularIntensityMap?`#define USE_SPECULAR_INTENSITYMAP`:``,n.roughnessMap?`#define USE_ROUGHNESSMAP`:``,n.metalnessMap?`#define USE_METALNESSMAP`:``,n.alphaMap?`#define USE_ALPHAMAP`:``,n.alphaTest?`#define USE_ALPHATEST`:``,n.alphaHash?`#define USE_ALPHAHASH`:``,n.sheen?`#define USE_SHEEN`:``,n.sheenColorMap?`#define USE_SHEEN_COLORMAP`:``,n.sheenRoughnessMap?`#define USE_SHEEN_ROUGHNESSMAP`:``,n.transmission?`#define USE_TRANSMISSION`:``,n.transmissionMap?`#define USE_TRANSMISSIONMAP`:``,n.thicknessMap?`#define USE_THICKNESSMAP`:``,n.vertexTangents&&n.flatShading===!1?`#define USE_TANGENT`:``,n.vertexColors||n.instancingColor?`#define USE_COLOR`:``,n.vertexAlphas||n.batchingColor?`#define USE_COLOR_ALPHA`:``,n.vertexUv1s?`#define USE_UV1`:``,n.vertexUv2s?`#define USE_UV2`:``,n.vertexUv3s?`#define USE_UV3`:``,n.pointsUvs?`#define USE_POINTS_UV`:``,n.gradientMap?`#define USE_GRADIENTMAP`:``,n.flatShading?`#define FLAT_SHADED`:``,n.doubleSided?`#define DOUBLE_SIDED`:``,n.flipSided?`#define FLIP_SIDED`:``,n.shadowMapEnabled?`#define USE_SHADOWMAP`:``,n.shadowMapEnabled?`#define `+c:``,n.premultipliedAlpha?`#define PREMULTIPLIED_ALPHA`:``,n.numLightProbes>0?`#define USE_LIGHT_PROBES`:``,n.decodeVideoTexture?`#define DECODE_VIDEO_TEXTURE`:``,n.decodeVideoTextureEmissive?`#define DECODE_VIDEO_TEXTURE_EMISSIVE`:``,n.logarithmicDepthBuffer?`#define USE_LOGARITHMIC_DEPTH_BUFFER`:``,n.reversedDepthBuffer?`#define USE_REVERSED_DEPTH_BUFFER`:``,`uniform mat4 viewMatrix;`,`uniform vec3 cameraPosition;`,`uniform bool isOrthographic;`,n.toneMapping===0?``:`#define TONE_MAPPING`,n.toneMapping===0?``:X.tonemapping_pars_fragment,n.toneMapping===0?``:vd(`toneMapping`,n.toneMapping),n.dithering?`#define DITHERING`:``,n.opaque?`#define OPAQUE`:``,X.colorspace_pars_fragment,gd(`linearToOutputTexel`,n.outputColorSpace),bd(),n.useDepthPacking?`#define DEPTH_PACKING `+n.depthPacking:``,`
`].filter(wd).join(`
`)),o=Od(o),o=Td(o,n),o=Ed(o,n),s=Od(s),s=Td(s,n),s=Ed(s,n),o=jd(o),s=jd(s),n.isRawShaderMaterial!==!0&&(_=`#version 300 es
`,h=[f,`#define attribute in`,`#define varying out`,`#define texture2D texture`].join(`
`)+`
`+h,g=[`#define varying in`,n.glslVersion===`300 es`?``:`layout(location = 0) out highp vec4 pc_fragColor;`,n.glslVersion===`300 es`?``:`#define gl_FragColor pc_fragColor`,`#define gl_FragDepthEXT gl_FragDepth`,`#define texture2D texture`,`#define textureCube texture`,`#define texture2DProj textureProj`,`#define texture2DLodEXT textureLod`,`#define texture2DProjLodEXT textureProjLod`,`#define textureCubeLodEXT textureLod`,`#define texture2DGradEXT textureGrad`,`#define texture2DProjGradEXT textureProjGrad`,`#define textureCubeGradEXT textureGrad`].join(`
`)+`
`+g);let v=_+h+o,y=_+g+s,b=ld(i,i.VERTEX_SHADER,v),x=ld(i,i.FRAGMENT_SHADER,y);i.attachShader(m,b),i.attachShader(m,x),n.index0AttributeName===void 0?n.hasPositionAttribute===!0&&i.bindAttribLocation(m,0,`position`):i.bindAttribLocation(m,0,n.index0AttributeName),i.linkProgram(m);function S(t){if(e.debug.checkShaderErrors){let n=i.getProgramInfoLog(m)||``,r=i.getShaderInfoLog(b)||``,a=i.getShaderInfoLog(x)||``,o=n.trim(),s=r.trim(),c=a.trim(),l=!0,u=!0;if(i.getProgramParameter(m,i.LINK_STATUS)===!1){if(l=!1,typeof e.debug.onShaderError==`function`)e.debug.onShaderError(i,m,b,x);else{let e=hd(i,b,`vertex`),n=hd(i,x,`fragment`);W(`WebGLProgram: Shader Error `+i.getError()+` - VALIDATE_STATUS `+i.getProgramParameter(m,i.VALIDATE_STATUS)+`

Material Name: `+t.name+`
Material Type: `+t.type+`

Program Info Log: `+o+`
`+e+`
`+n)}}else o===``?(s===``||c===``)&&(u=!1):U(`WebGLProgram: Program Info Log:`,o);u&&(t.diagnostics={runnable:l,programLog:o,vertexShader:{log:s,prefix:h},fragmentShader:{log:c,prefix:g}})}i.deleteShader(b),i.deleteShader(x),C=new cd(i,m),w=Cd(i,m)}let C;this.getUniforms=function(){return C===void 0&&S(this),C};let w;this.getAttributes=function(){return w===void 0&&S(this),w};let T=n.rendererExtensionParallelShaderCompile===!1;return this.isReady=function(){return T===!1&&(T=i.getProgramParameter(m,ud)),T},this.destroy=function(){r.releaseStatesOfProgram(this),i.deleteProgram(m),this.program=void 0},this.type=n.shaderType,this.name=n.shaderName,this.id=dd++,this.cacheKey=t,this.usedTimes=1,this.program=m,this.vertexShader=b,this.fragmentShader=x,this}var Vd=0,Hd=class{constructor(){this.shaderCache=new Map,this.materialCache=new Map}update(e,t,n){let r=this._getShaderCacheForMaterial(e);return r.has(t)===!1&&(r.add(t),t.usedTimes++),r.has(n)===!1&&(r.add(n),n.usedTimes++),this}remove(e){let t=this.materialCache.get(e);for(let e of t)e.usedTimes--,e.usedTimes===0&&this.shaderCache.delete(e.code);return this.materialCache.delete(e),this}getVertexShaderStage(e){return this._getShaderStage(e.vertexShader)}getFragmentShaderStage(e){return this._getShaderStage(e.fragmentShader)}dispose(){this.shaderCache.clear(),this.materialCache.clear()}_getShaderCacheForMaterial(e){let t=this.materialCache,n=t.get(e);return n===void 0&&(n=new Set,t.set(e,n)),n}_getShaderStage(e){let t=this.shaderCache,n=t.get(e);return n===void 0&&(n=new Ud(e),t.set(e,n)),n}},Ud=class{constructor(e){this.id=Vd++,this.code=e,this.usedTimes=0}};function Wd(e){return e===1030||e===37490||e===36285}function Gd(e,t,n,r,i,a){let o=new Yr,s=new Hd,c=new Set,l=[],u=new Map,d=r.logarithmicDepthBuffer,f={MeshDepthMaterial:`depth`,MeshDistanceMaterial:`distance`,MeshNormalMaterial:`normal`,MeshBasicMaterial:`basic`,MeshLambertMaterial:`lambert`,MeshPhongMaterial:`phong`,MeshToonMaterial:`toon`,MeshStandardMaterial:`physical`,MeshPhysicalMaterial:`physical`,MeshMatcapMaterial:`matcap`,LineBasicMaterial:`basic`,LineDashedMaterial:`dashed`,PointsMaterial:`points`,ShadowMaterial:`shadow`,SpriteMaterial:`sprite`};function p(e){return c.add(e),e===0?`uv`:`uv${e}`}function m(i,o,l,u,m,h){let g=u.fog,_=m.geometry,v=i.isMeshStandardMaterial||i.isMeshLambertMaterial||i.isMeshPhongMaterial?u.environment:null,y=i.isMeshStandardMaterial||i.isMeshLambertMaterial&&!i.envMap||i.isMeshPhongMaterial&&!i.envMap,b=t.get(i.envMap||v,y),x=f[i.type],S=r.precision;i.precision!==null&&(S=r.getMaxPrecision(i.precision),S!==i.precision&&U(`WebGLProgram.getParameters:`,i.precision,`not supported, using`,S,`instead.`));let C=_.morphAttributes.position||_.morphAttributes.normal||_.morphAttributes.color,w=C===void 0?0:C.length,T=0;_.morphAttributes.position!==void 0&&(T=1),_.morphAttributes.normal!==void 0&&(T=2),_.morphAttributes.color!==void 0&&(T=3);let E,D,O,k;if(x){let e=yl[x];E=e.vertexShader,D=e.fragmentShader}else{E=i.vertexShader,D=i.fragmentShader;let e=s.getVertexShaderStage(i),t=s.getFragmentShaderStage(i);s.update(i,e,t),O=e.id,k=t.id}let A=e.getRenderTarget(),j=e.state.buffers.depth.getReversed(),M=m.isInstancedMesh===!0,N=m.isBatchedMesh===!0,P=!!i.map,ee=!!i.matcap,F=!!b,te=F&&b.isPMREMTexture===!0,ne=!!i.aoMap,re=!!i.lightMap,ie=!!i.bumpMap&&i.wireframe===!1,I=!!i.normalMap,ae=!!i.displacementMap,oe=!!i.emissiveMap,L=!!i.metalnessMap,R=!!i.roughnessMap,se=i.anisotropy>0,ce=i.clearcoat>0,le=i.diffuseRoughness>0,ue=i.dispersion>0,de=i.retroreflectivity>0,fe=i.iridescence>0,pe=i.sheen>0,me=i.transmission>0,he=se&&!!i.anisotropyMap,ge=ce&&!!i.clearcoatMap,_e=ce&&!!i.clearcoatNormalMap,ve=ce&&!!i.clearcoatRoughnessMap,ye=le&&!!i.diffuseRoughnessMap,z=fe&&!!i.iridescenceMap,be=fe&&!!i.iridescenceThicknessMap,xe=pe&&!!i.sheenColorMap,Se=pe&&!!i.sheenRoughnessMap,B=!!i.specularMap,Ce=!!i.specularColorMap,V=!!i.specularIntensityMap,H=me&&!!i.transmissionMap,we=me&&!!i.thicknessMap,Te=!!i.gradientMap,Ee=!!i.alphaMap,De=i.alphaTest>0,Oe=!!i.alphaHash,ke=!!i.extensions,Ae=0;i.toneMapped&&(A===null||A.isXRRenderTarget===!0)&&(Ae=e.toneMapping);let je=te?b.isCompressedCubeTexture?b.image[0].mipmaps:b.mipmaps:null,Me={shaderID:x,shaderType:i.type,shaderName:i.name,vertexShader:E,fragmentShader:D,defines:i.defines,customVertexShaderID:O,customFragmentShaderID:k,isRawShaderMaterial:i.isRawShaderMaterial===!0,glslVersion:i.glslVersion,precision:S,batching:N,batchingColor:N&&m._colorsTexture!==null,instancing:M,instancingColor:M&&m.instanceColor!==null,instancingMorph:M&&m.morphTexture!==null,outputColorSpace:A===null?e.outputColorSpace:A.isXRRenderTarget===!0?A.texture.colorSpace:Sr.workingColorSpace,alphaToCoverage:!!i.alphaToCoverage,map:P,matcap:ee,envMap:F,envMapMode:F&&b.mapping,envMapPMREM:te,envMapMaxLod:te?je.length-1:null,envMapSize:te?je[0].width:null,aoMap:ne,lightMap:re,bumpMap:ie,normalMap:I,displacementMap:ae,emissiveMap:oe,normalMapObjectSpace:I&&i.normalMapType===1,normalMapTangentSpace:I&&i.normalMapType===0,packedNormalMap:I&&i.normalMapType===0&&Wd(i.normalMap.format),metalnessMap:L,roughnessMap:R,anisotropy:se,anisotropyMap:he,clearcoat:ce,clearcoatMap:ge,clearcoatNormalMap:_e,clearcoatRoughnessMap:ve,diffuseRoughness:le,diffuseRoughnessMap:ye,dispersion:ue,retroreflection:de,iridescence:fe,iridescenceMap:z,iridescenceThicknessMap:be,sheen:pe,sheenColorMap:xe,sheenRoughnessMap:Se,specularMap:B,specularColorMap:Ce,specularIntensityMap:V,transmission:me,transmissionMap:H,thicknessMap:we,gradientMap:Te,opaque:i.transparent===!1&&i.blending===1&&i.alphaToCoverage===!1,alphaMap:Ee,alphaTest:De,alphaHash:Oe,combine:i.combine,mapUv:P&&p(i.map.channel),aoMapUv:ne&&p(i.aoMap.channel),lightMapUv:re&&p(i.lightMap.channel),bumpMapUv:ie&&p(i.bumpMap.channel),normalMapUv:I&&p(i.normalMap.channel),displacementMapUv:ae&&p(i.displacementMap.channel),emissiveMapUv:oe&&p(i.emissiveMap.channel),metalnessMapUv:L&&p(i.metalnessMap.channel),roughnessMapUv:R&&p(i.roughnessMap.channel),anisotropyMapUv:he&&p(i.anisotropyMap.channel),clearcoatMapUv:ge&&p(i.clearcoatMap.channel),clearcoatNormalMapUv:_e&&p(i.clearcoatNormalMap.channel),clearcoatRoughnessMapUv:ve&&p(i.clearcoatRoughnessMap.channel),diffuseRoughnessMapUv:ye&&p(i.diffuseRoughnessMap.channel),iridescenceMapUv:z&&p(i.iridescenceMap.channel),iridescenceThicknessMapUv:be&&p(i.iridescenceThicknessMap.channel),sheenColorMapUv:xe&&p(i.sheenColorMap.channel),sheenRoughnessMapUv:Se&&p(i.sheenRoughnessMap.channel),specularMapUv:B&&p(i.specularMap.channel),specularColorMapUv:Ce&&p(i.specularColorMap.channel),specularIntensityMapUv:V&&p(i.specularIntensityMap.channel),transmissionMapUv:H&&p(i.transmissionMap.channel),thicknessMapUv:we&&p(i.thicknessMap.channel),alphaMapUv:Ee&&p(i.alphaMap.channel),vertexTangents:!!_.attributes.tangent&&(I||se),vertexNormals:!!_.attributes.normal,vertexColors:i.vertexColors,vertexAlphas:i.vertexColors===!0&&!!_.attributes.color&&_.attributes.color.itemSize===4,pointsUvs:m.isPoints===!0&&!!_.attributes.uv&&(P||Ee),fog:!!g,useFog:i.fog===!0,fogExp2:!!g&&g.isFogExp2,flatShading:i.wireframe===!1&&(i.flatShading===!0||_.attributes.normal===void 0&&I===!1&&(i.isMeshLambertMaterial||i.isMeshPhongMaterial||i.isMeshStandardMaterial||i.isMeshPhysicalMaterial)),sizeAttenuation:i.sizeAttenuation===!0,logarithmicDepthBuffer:d,reversedDepthBuffer:j,skinning:m.isSkinnedMesh===!0,hasPositionAttribute:_.attributes.position!==void 0,morphTargets:_.morphAttributes.position!==void 0,morphNormals:_.morphAttributes.normal!==void 0,morphColors:_.morphAttributes.color!==void 0,morphTargetsCount:w,morphTextureStride:T,numSunLights:o.sun.length,numDirLights:o.directional.length,numPointLights:o.point.length,numSpotLights:o.spot.length,numSpotLightMaps:o.spotLightMap.length,numRectAreaLights:o.rectArea.length,numHemiLights:o.hemi.length,numSunLightShadows:o.sunShadowMap.length,numDirLightShadows:o.directionalShadowMap.length,numPointLightShadows:o.pointShadowMap.length,numSpotLightShadows:o.spotShadowMap.length,numSpotLightShadowsWithMaps:o.numSpotLightShadowsWithMaps,numLightProbes:o.numLightProbes,numLightProbeGrids:h.filter(e=>e.texture!==null).length,numClippingPlanes:a.numPlanes,numClipIntersection:a.numIntersection,dithering:i.dithering,shadowMapEnabled:e.shadowMap.enabled&&l.length>0,shadowMapType:e.shadowMap.type,toneMapping:Ae,decodeVideoTexture:P&&i.map.isVideoTexture===!0&&Sr.getTransfer(i.map.colorSpace)===`srgb`,decodeVideoTextureEmissive:oe&&i.emissiveMap.isVideoTexture===!0&&Sr.getTransfer(i.emissiveMap.colorSpace)===`srgb`,premultipliedAlpha:i.premultipliedAlpha,doubleSided:i.side===2,flipSided:i.side===1,useDepthPacking:i.depthPacking>=0,depthPacking:i.depthPacking||0,index0AttributeName:i.index0AttributeName,extensionClipCullDistance:ke&&i.extensions.clipCullDistance===!0&&n.has(`WEBGL_clip_cull_distance`),extensionMultiDraw:(ke&&i.extensions.multiDraw===!0||N)&&n.has(`WEBGL_multi_draw`),rendererExtensionParallelShaderCompile:n.has(`KHR_parallel_shader_compile`),customProgramCacheKey:i.customProgramCacheKey()};return Me.vertexUv1s=c.has(1),Me.vertexUv2s=c.has(2),Me.vertexUv3s=c.has(3),c.clear(),Me}function h(t){let n=[];if(t.shaderID?n.push(t.shaderID):(n.push(t.customVertexShaderID),n.push(t.customFragmentShaderID)),t.defines!==void 0)for(let e in t.defines)n.push(e),n.push(t.defines[e]);return t.isRawShaderMaterial===!1&&(g(n,t),_(n,t),n.push(e.outputColorSpace)),n.push(t.customProgramCacheKey),n.join()}function g(e,t){e.push(t.precision),e.push(t.outputColorSpace),e.push(t.envMapMode),e.push(t.envMapPMREM),e.push(t.envMapMaxLod),e.push(t.envMapSize),e.push(t.mapUv),e.push(t.alphaMapUv),e.push(t.lightMapUv),e.push(t.aoMapUv),e.push(t.bumpMapUv),e.push(t.normalMapUv),e.push(t.displacementMapUv),e.push(t.emissiveMapUv),e.push(t.metalnessMapUv),e.push(t.roughnessMapUv),e.push(t.anisotropyMapUv),e.push(t.clearcoatMapUv),e.push(t.clearcoatNormalMapUv),e.push(t.clearcoatRoughnessMapUv),e.push(t.diffuseRoughnessMapUv),e.push(t.iridescenceMapUv),e.push(t.iridescenceThicknessMapUv),e.push(t.sheenColorMapUv),e.push(t.sheenRoughnessMapUv),e.push(t.specularMapUv),e.push(t.specularColorMapUv),e.push(t.specularIntensityMapUv),e.push(t.transmissionMapUv),e.push(t.thicknessMapUv),e.push(t.combine),e.push(t.fogExp2),e.push(t.sizeAttenuation),e.push(t.morphTargetsCount),e.push(t.numSunLights),e.push(t.numDirLights),e.push(t.numPointLights),e.push(t.numSpotLights),e.push(t.numSpotLightMaps),e.push(t.numHemiLights),e.push(t.numRectAreaLights),e.push(t.numSunLightShadows),e.push(t.numDirLightShadows),e.push(t.numPointLightShadows),e.push(t.numSpotLightShadows),e.push(t.numSpotLightShadowsWithMaps),e.push(t.numLightProbes),e.push(t.numLightProbeGrids),e.push(t.shadowMapType),e.push(t.toneMapping),e.push(t.numClippingPlanes),e.push(t.numClipIntersection),e.push(t.depthPacking)}function _(e,t){o.disableAll(),t.instancing&&o.enable(0),t.instancingColor&&o.enable(1),t.instancingMorph&&o.enable(2),t.matcap&&o.enable(3),t.envMap&&o.enable(4),t.normalMapObjectSpace&&o.enable(5),t.normalMapTangentSpace&&o.enable(6),t.clearcoat&&o.enable(7),t.iridescence&&o.enable(8),t.alphaTest&&o.enable(9),t.vertexColors&&o.enable(10),t.vertexAlphas&&o.enable(11),t.vertexUv1s&&o.enable(12),t.vertexUv2s&&o.enable(13),t.vertexUv3s&&o.enable(14),t.vertexTangents&&o.enable(15),t.anisotropy&&o.enable(16),t.alphaHash&&o.enable(17),t.batching&&o.enable(18),t.dispersion&&o.enable(19),t.retroreflection&&o.enable(24),t.diffuseRoughness&&o.enable(25),t.batchingColor&&o.enable(20),t.gradientMap&&o.enable(21),t.packedNormalMap&&o.enable(22),t.vertexNormals&&o.enable(23),e.push(o.mask),o.disableAll(),t.fog&&o.enable(0),t.useFog&&o.enable(1),t.flatShading&&o.enable(2),t.logarithmicDepthBuffer&&o.enable(3),t.reversedDepthBuffer&&o.enable(4),t.skinning&&o.enable(5),t.morphTargets&&o.enable(6),t.morphNormals&&o.enable(7),t.morphColors&&o.enable(8),t.premultipliedAlpha&&o.enable(9),t.shadowMapEnabled&&o.enable(10),t.doubleSided&&o.enable(11),t.flipSided&&o.enable(12),t.useDepthPacking&&o.enable(13),t.dithering&&o.enable(14),t.transmission&&o.enable(15),t.sheen&&o.enable(16),t.opaque&&o.enable(17),t.pointsUvs&&o.enable(18),t.decodeVideoTexture&&o.enable(19),t.decodeVideoTextureEmissive&&o.enable(20),t.alphaToCoverage&&o.enable(21),t.numLightProbeGrids>0&&o.enable(22),t.hasPositionAttribute&&o.enable(23),e.push(o.mask)}function v(e){let t=f[e.type],n;if(t){let e=yl[t];n=sc.clone(e.uniforms)}else n=e.uniforms;return n}function y(t,n){let r=u.get(n);return r===void 0?(r=new Bd(e,n,t,i),l.push(r),u.set(n,r)):++r.usedTimes,r}function b(e){if(--e.usedTimes===0){let t=l.indexOf(e);l[t]=l[l.length-1],l.pop(),u.delete(e.cacheKey),e.destroy()}}function x(e){s.remove(e)}function S(){s.dispose()}return{getParameters:m,getProgramCacheKey:h,getUniforms:v,acquireProgram:y,releaseProgram:b,releaseShaderCache:x,programs:l,dispose:S}}function Kd(){let e=new WeakMap;function t(t){return e.has(t)}function n(t){let n=e.get(t);return n===void 0&&(n={},e.set(t,n)),n}function r(t){e.delete(t)}function i(t,n,r){e.get(t)[n]=r}function a(){e=new WeakMap}return{has:t,get:n,remove:r,update:i,dispose:a}}function qd(e,t){return e.groupOrder===t.groupOrder?e.renderOrder===t.renderOrder?e.material.id===t.material.id?e.materialVariant===t.materialVariant?e.z===t.z?e.id-t.id:e.z-t.z:e.materialVariant-t.materialVariant:e.material.id-t.material.id:e.renderOrder-t.renderOrder:e.groupOrder-t.groupOrder}function Jd(e,t){return e.groupOrder===t.groupOrder?e.renderOrder===t.renderOrder?e.z===t.z?e.id-t.id:t.z-e.z:e.renderOrder-t.renderOrder:e.groupOrder-t.groupOrder}function Yd(){let e=[],t=0,n=[],r=[],i=[];function a(){t=0,n.length=0,r.length=0,i.length=0}function o(e){let t=0;return e.isInstancedMesh&&(t+=2),e.isSkinnedMesh&&(t+=1),t}function s(n,r,i,a,s,c){let l=e[t];return l===void 0?(l={id:n.id,object:n,geometry:r,material:i,materialVariant:o(n),groupOrder:a,renderOrder:n.renderOrder,z:s,group:c},e[t]=l):(l.id=n.id,l.object=n,l.geometry=r,l.material=i,l.materialVariant=o(n),l.groupOrder=a,l.renderOrder=n.renderOrder,l.z=s,l.group=c),t++,l}function c(e,t,a,o,c,l,u){u.reversedDepth===!0&&(c=-c);let d=s(e,t,a,o,c,l);a.transmission>0?r.push(d):a.transparent===!0?i.push(d):n.push(d)}function l(e,t,a,o,c,l){let u=s(e,t,a,o,c,l);a.transmission>0?r.unshift(u):a.transparent===!0?i.unshift(u):n.unshift(u)}function u(e,t){n.length>1&&n.sort(e||qd),r.length>1&&r.sort(t||Jd),i.length>1&&i.sort(t||Jd)}function d(){for(let n=t,r=e.length;n<r;n++){let t=e[n];if(t.id===null)break;t.id=null,t.object=null,t.geometry=null,t.material=null,t.group=null}}return{opaque:n,transmissive:r,transparent:i,init:a,push:c,unshift:l,finish:d,sort:u}}function Xd(){let e=new WeakMap;function t(t,n){let r=e.get(t),i;return r===void 0?(i=new Yd,e.set(t,[i])):n>=r.length?(i=new Yd,r.push(i)):i=r[n],i}function n(){e=new WeakMap}return{get:t,dispose:n}}function Zd(){let e={};return{get:function(t){if(e[t.id]!==void 0)return e[t.id];let n;switch(t.type){case`SunLight`:case`DirectionalLight`:n={direction:new q,color:new Y};break;case`SpotLight`:n={position:new q,direction:new q,color:new Y,distance:0,coneCos:0,penumbraCos:0,decay:0};break;case`PointLight`:n={position:new q,color:new Y,distance:0,decay:0};break;case`HemisphereLight`:n={direction:new q,skyColor:new Y,groundColor:new Y};break;case`RectAreaLight`:n={color:new Y,position:new q,halfWidth:new q,halfHeight:new q}}return e[t.id]=n,n}}}function Qd(){let e={};return{get:function(t){if(e[t.id]!==void 0)return e[t.id];let n;switch(t.type){case`SunLight`:case`DirectionalLight`:n={shadowIntensity:1,shadowBias:0,shadowNormalBias:0,shadowRadius:1,shadowMapSize:new K};break;case`SpotLight`:n={shadowIntensity:1,shadowBias:0,shadowNormalBias:0,shadowRadius:1,shadowMapSize:new K};break;case`PointLight`:n={shadowIntensity:1,shadowBias:0,shadowNormalBias:0,shadowRadius:1,shadowMapSize:new K,shadowCameraNear:1,shadowCameraFar:1e3}}return e[t.id]=n,n}}}var $d=0;function ef(e,t){return(t.castShadow?2:0)-(e.castShadow?2:0)+ +!!t.map-!!e.map}function tf(e){let t=new Zd,n=Qd(),r={version:0,hash:{sunLength:-1,directionalLength:-1,pointLength:-1,spotLength:-1,rectAreaLength:-1,hemiLength:-1,numSunShadows:-1,numDirectionalShadows:-1,numPointShadows:-1,numSpotShadows:-1,numSpotMaps:-1,numLightProbes:-1},ambient:[0,0,0],probe:[],sun:[],sunShadow:[],sunShadowMap:[],sunShadowMatrix:[],sunShadowCascade:[],directional:[],directionalShadow:[],directionalShadowMap:[],directionalShadowMatrix:[],spot:[],spotLightMap:[],spotShadow:[],spotShadowMap:[],spotLightMatrix:[],rectArea:[],rectAreaLTC1:null,rectAreaLTC2:null,point:[],pointShadow:[],pointShadowMap:[],pointShadowMatrix:[],hemi:[],numSpotLightShadowsWithMaps:0,numLightProbes:0};for(let e=0;e<9;e++)r.probe.push(new q);let i=new q,a=new Rr,o=new Rr;function s(i){let a=0,o=0,s=0;for(let e=0;e<9;e++)r.probe[e].set(0,0,0);let c=0,l=0,u=0,d=0,f=0,p=0,m=0,h=0,g=0,_=0,v=0,y=0,b=0,x=0;i.sort(ef);for(let e=0,S=i.length;e<S;e++){let S=i[e],C=S.color,w=S.intensity,T=S.distance,E=null;if(S.shadow&&S.shadow.map&&(E=S.shadow.map.texture.format===1030?S.shadow.map.texture:S.shadow.map.depthTexture||S.shadow.map.texture),S.isAmbientLight)a+=C.r*w,o+=C.g*w,s+=C.b*w;else if(S.isLightProbe){for(let e=0;e<9;e++)r.probe[e].addScaledVector(S.sh.coefficients[e],w);x++}else if(S.isSunLight){let e=t.get(S);if(e.color.copy(S.color).multiplyScalar(S.intensity),S.castShadow){let e=S.shadow,t=n.get(S);t.shadowIntensity=e.intensity,t.shadowBias=e.bias,t.shadowNormalBias=e.normalBias,t.shadowRadius=e.radius,t.shadowMapSize.copy(e.mapSize).multiply(e.getFrameExtents()),r.sunShadow[l]=t,r.sunShadowMap[l]=E;let i=e.getViewportCount();for(let t=0;t<i;t++)r.sunShadowMatrix[u+t]=e.getMatrix(t),r.sunShadowCascade[u+t]=e._cascadeData[t];u+=i,l++}r.sun[c]=e,c++}else if(S.isDirectionalLight){let e=t.get(S);if(e.color.copy(S.color).multiplyScalar(S.intensity),S.castShadow){let e=S.shadow,t=n.get(S);t.shadowIntensity=e.intensity,t.shadowBias=e.bias,t.shadowNormalBias=e.normalBias,t.shadowRadius=e.radius,t.shadowMapSize=e.mapSize,r.directionalShadow[d]=t,r.directionalShadowMap[d]=E,r.directionalShadowMatrix[d]=S.shadow.matrix,g++}r.directional[d]=e,d++}else if(S.isSpotLight){let e=t.get(S);e.position.setFromMatrixPosition(S.matrixWorld),e.color.copy(C).multiplyScalar(w),e.distance=T,e.coneCos=Math.cos(S.angle),e.penumbraCos=Math.cos(S.angle*(1-S.penumbra)),e.decay=S.decay,r.spot[p]=e;let i=S.shadow;if(S.map&&(r.spotLightMap[y]=S.map,y++,i.updateMatrices(S),S.castShadow&&b++),r.spotLightMatrix[p]=i.matrix,S.castShadow){let e=n.get(S);e.shadowIntensity=i.intensity,e.shadowBias=i.bias,e.shadowNormalBias=i.normalBias,e.shadowRadius=i.radius,e.shadowMapSize=i.mapSize,r.spotShadow[p]=e,r.spotShadowMap[p]=E,v++}p++}else if(S.isRectAreaLight){let e=t.get(S);e.color.copy(C).multiplyScalar(w),e.halfWidth.set(S.width*.5,0,0),e.halfHeight.set(0,S.height*.5,0),r.rectArea[m]=e,m++}else if(S.isPointLight){let e=t.get(S);if(e.color.copy(S.color).multiplyScalar(S.intensity),e.distance=S.distance,e.decay=S.decay,S.castShadow){let e=S.shadow,t=n.get(S);t.shadowIntensity=e.intensity,t.shadowBias=e.bias,t.shadowNormalBias=e.normalBias,t.shadowRadius=e.radius,t.shadowMapSize=e.mapSize,t.shadowCameraNear=e.camera.near,t.shadowCameraFar=e.camera.far,r.pointShadow[f]=t,r.pointShadowMap[f]=E,r.pointShadowMatrix[f]=S.shadow.matrix,_++}r.point[f]=e,f++}else if(S.isHemisphereLight){let e=t.get(S);e.skyColor.copy(S.color).multiplyScalar(w),e.groundColor.copy(S.groundColor).multiplyScalar(w),r.hemi[h]=e,h++}}m>0&&(e.has(`OES_texture_float_linear`)===!0?(r.rectAreaLTC1=Z.LTC_FLOAT_1,r.rectAreaLTC2=Z.LTC_FLOAT_2):(r.rectAreaLTC1=Z.LTC_HALF_1,r.rectAreaLTC2=Z.LTC_HALF_2)),r.ambient[0]=a,r.ambient[1]=o,r.ambient[2]=s;let S=r.hash;(S.sunLength!==c||S.directionalLength!==d||S.pointLength!==f||S.spotLength!==p||S.rectAreaLength!==m||S.hemiLength!==h||S.numSunShadows!==l||S.numDirectionalShadows!==g||S.numPointShadows!==_||S.numSpotShadows!==v||S.numSpotMaps!==y||S.numLightProbes!==x)&&(r.sun.length=c,r.directional.length=d,r.spot.length=p,r.rectArea.length=m,r.point.length=f,r.hemi.length=h,r.sunShadow.length=l,r.sunShadowMap.length=l,r.sunShadowMatrix.length=u,r.sunShadowCascade.length=u,r.directionalShadow.length=g,r.directionalShadowMap.length=g,r.directionalShadowMatrix.length=g,r.pointShadow.length=_,r.pointShadowMap.length=_,r.pointShadowMatrix.length=_,r.spotShadow.length=v,r.spotShadowMap.length=v,r.spotLightMatrix.length=v+y-b,r.spotLightMap.length=y,r.numSpotLightShadowsWithMaps=b,r.numLightProbes=x,S.sunLength=c,S.directionalLength=d,S.pointLength=f,S.spotLength=p,S.rectAreaLength=m,S.hemiLength=h,S.numSunShadows=l,S.numDirectionalShadows=g,S.numPointShadows=_,S.numSpotShadows=v,S.numSpotMaps=y,S.numLightProbes=x,r.version=$d++)}function c(e,t){let n=0,s=0,c=0,l=0,u=0,d=0,f=t.matrixWorldInverse;for(let t=0,p=e.length;t<p;t++){let p=e[t];if(p.isSunLight){let e=r.sun[n];e.direction.setFromMatrixPosition(p.matrixWorld),e.direction.transformDirection(f),n++}else if(p.isDirectionalLight){let e=r.directional[s];e.direction.setFromMatrixPosition(p.matrixWorld),i.setFromMatrixPosition(p.target.matrixWorld),e.direction.sub(i),e.direction.transformDirection(f),s++}else if(p.isSpotLight){let e=r.spot[l];e.position.setFromMatrixPosition(p.matrixWorld),e.position.applyMatrix4(f),e.direction.setFromMatrixPosition(p.matrixWorld),i.setFromMatrixPosition(p.target.matrixWorld),e.direction.sub(i),e.direction.transformDirection(f),l++}else if(p.isRectAreaLight){let e=r.rectArea[u];e.position.setFromMatrixPosition(p.matrixWorld),e.position.applyMatrix4(f),o.identity(),a.copy(p.matrixWorld),a.premultiply(f),o.extractRotation(a),e.halfWidth.set(p.width*.5,0,0),e.halfHeight.set(0,p.height*.5,0),e.halfWidth.applyMatrix4(o),e.halfHeight.applyMatrix4(o),u++}else if(p.isPointLight){let e=r.point[c];e.position.setFromMatrixPosition(p.matrixWorld),e.position.applyMatrix4(f),c++}else if(p.isHemisphereLight){let e=r.hemi[d];e.direction.setFromMatrixPosition(p.matrixWorld),e.direction.transformDirection(f),d++}}}return{setup:s,setupView:c,state:r}}function nf(e){let t=new tf(e),n=[],r=[],i=[];function a(e){u.camera=e,n.length=0,r.length=0,i.length=0}function o(e){e.isLightProbeGrid?i.push(e):n.push(e)}function s(e){r.push(e)}function c(){t.setup(n),i.sort((e,t)=>e.priority-t.priority||e.id-t.id)}function l(e){t.setupView(n,e)}let u={lightsArray:n,shadowsArray:r,lightProbeGridArray:i,camera:null,lights:t,transmissionRenderTarget:{},textureUnits:0};return{init:a,state:u,setupLights:c,setupLightsView:l,pushLight:o,pushShadow:s}}function rf(e){let t=new WeakMap;function n(n,r=0){let i=t.get(n),a;return i===void 0?(a=new nf(e),t.set(n,[a])):r>=i.length?(a=new nf(e),i.push(a)):a=i[r],a}function r(){t=new WeakMap}return{get:n,dispose:r}}var af=`void main() {
	gl_Position = vec4( position, 1.0 );
}`,of=`uniform sampler2D shadow_pass;
uniform vec2 resolution;
uniform float radius;
void main() {
	const float samples = float( VSM_SAMPLES );
	float mean = 0.0;
	float squared_mean = 0.0;
	float uvStride = samples <= 1.0 ? 0.0 : 2.0 / ( samples - 1.0 );
	float uvStart = samples <= 1.0 ? 0.0 : - 1.0;
	for ( float i = 0.0; i < samples; i ++ ) {
		float uvOffset = uvStart + i * uvStride;
		#ifdef HORIZONTAL_PASS
			vec2 distribution = texture2D( shadow_pass, ( gl_FragCoord.xy + vec2( uvOffset, 0.0 ) * radius ) / resolution ).rg;
			mean += distribution.x;
			squared_mean += distribution.y * distribution.y + distribution.x * distribution.x;
		#else
			float depth = texture2D( shadow_pass, ( gl_FragCoord.xy + vec2( 0.0, uvOffset ) * radius ) / resolution ).r;
			mean += depth;
			squared_mean += depth * depth;
		#endif
	}
	mean = mean / samples;
	squared_mean = squared_mean / samples;
	float std_dev = sqrt( max( 0.0, squared_mean - mean * mean ) );
	gl_FragColor = vec4( mean, std_dev, 0.0, 1.0 );
}`,sf=[new q(1,0,0),new q(-1,0,0),new q(0,1,0),new q(0,-1,0),new q(0,0,1),new q(0,0,-1)],cf=[new q(0,-1,0),new q(0,-1,0),new q(0,0,1),new q(0,0,-1),new q(0,-1,0),new q(0,-1,0)],lf=new Rr,uf=new q,df=new q;function ff(e,t,n){let r=new io,i=new K,a=new K,o=new Nr,s=new fc,c=new pc,l={},u=n.maxTextureSize,d={0:1,1:0,2:2},f=new uc({defines:{VSM_SAMPLES:8},uniforms:{shadow_pass:{value:null},resolution:{value:new K},radius:{value:4}},vertexShader:af,fragmentShader:of}),p=f.clone();p.defines.HORIZONTAL_PASS=1;let m=new ma;m.setAttribute(`position`,new $i(new Float32Array([-1,-1,.5,3,-1,.5,-1,3,.5]),3));let h=new Ha(m,f),g=this;this.enabled=!1,this.autoUpdate=!0,this.needsUpdate=!1,this.type=1;let _=this.type;this.render=function(t,n,s){if(g.enabled===!1||g.autoUpdate===!1&&g.needsUpdate===!1||t.length===0)return;this.type===2&&(U(`WebGLShadowMap: PCFSoftShadowMap has been removed. Using PCFShadowMap instead.`),this.type=1);let c=e.getRenderTarget(),l=e.getActiveCubeFace(),d=e.getActiveMipmapLevel(),f=e.state;f.setBlending(0),f.buffers.depth.getReversed()===!0?f.buffers.color.setClear(0,0,0,0):f.buffers.color.setClear(1,1,1,1),f.buffers.depth.setTest(!0),f.setScissorTest(!1);let p=_!==this.type;p&&n.traverse(function(e){e.material&&(Array.isArray(e.material)?e.material.forEach(e=>e.needsUpdate=!0):e.material.needsUpdate=!0)});for(let c=0,l=t.length;c<l;c++){let l=t[c],d=l.shadow;if(d===void 0){U(`WebGLShadowMap:`,l,`has no shadow.`);continue}if(d.autoUpdate===!1&&d.needsUpdate===!1)continue;i.copy(d.mapSize);let m=d.getFrameExtents();i.multiply(m),a.copy(d.mapSize),(i.x>u||i.y>u)&&(i.x>u&&(a.x=Math.floor(u/m.x),i.x=a.x*m.x,d.mapSize.x=a.x),i.y>u&&(a.y=Math.floor(u/m.y),i.y=a.y*m.y,d.mapSize.y=a.y));let h=e.state.buffers.depth.getReversed();if(d.camera._reversedDepth=h,d.map===null||p===!0){if(d.map!==null&&(d.map.depthTexture!==null&&(d.map.depthTexture.dispose(),d.map.depthTexture=null),d.map.dispose()),this.type===3){if(l.isPointLight){U(`WebGLShadowMap: VSM shadow maps are not supported for PointLights. Use PCF or BasicShadowMap instead.`);continue}d.map=new Fr(i.x,i.y,{format:kt,type:gt,minFilter:ot,magFilter:ot,generateMipmaps:!1}),d.map.texture.name=l.name+`.shadowMap`,d.map.depthTexture=new jo(i.x,i.y,ht),d.map.depthTexture.name=l.name+`.shadowMapDepth`,d.map.depthTexture.format=Tt,d.map.depthTexture.compareFunction=null,d.map.depthTexture.minFilter=rt,d.map.depthTexture.magFilter=rt}else l.isPointLight?(d.map=new Ol(i.x),d.map.depthTexture=new Mo(i.x,mt)):(d.map=new Fr(i.x,i.y),d.map.depthTexture=new jo(i.x,i.y,mt)),d.map.depthTexture.name=l.name+`.shadowMap`,d.map.depthTexture.format=Tt,this.type===1?(d.map.depthTexture.compareFunction=h?518:515,d.map.depthTexture.minFilter=ot,d.map.depthTexture.magFilter=ot):(d.map.depthTexture.compareFunction=null,d.map.depthTexture.minFilter=rt,d.map.depthTexture.magFilter=rt);d.camera.updateProjectionMatrix()}d.map.isWebGLCubeRenderTarget!==!0&&(d.map.width!==i.x||d.map.height!==i.y)&&d.map.setSize(i.x,i.y);let g=d.map.isWebGLCubeRenderTarget?6:d.getViewportCount();l.isPointLight!==!0&&d.updateMatrices(l,s);let _=d.camera.layers.mask&4294967294?d.camera.layers:s.layers;for(let t=0;t<g;t++){let i=d.getCamera(t);if(l.isPointLight){let e=d.camera,n=d.matrix,r=l.distance||e.far;r!==e.far&&(e.far=r,e.updateProjectionMatrix()),uf.setFromMatrixPosition(l.matrixWorld),e.position.copy(uf),df.copy(e.position),df.add(sf[t]),e.up.copy(cf[t]),e.lookAt(df),e.updateMatrixWorld(),n.makeTranslation(-uf.x,-uf.y,-uf.z),lf.multiplyMatrices(e.projectionMatrix,e.matrixWorldInverse),d._frustum.setFromProjectionMatrix(lf,e.coordinateSystem,e.reversedDepth)}if(d.map.isWebGLCubeRenderTarget)e.setRenderTarget(d.map,t),e.clear();else{t===0&&(e.setRenderTarget(d.map),e.clear());let n=d.getViewport(t);o.set(a.x*n.x,a.y*n.y,a.x*n.z,a.y*n.w),f.viewport(o)}r=d.getFrustum(t),b(n,s,i,l,_,this.type)}d.isPointLightShadow!==!0&&this.type===3&&v(d,s),d.needsUpdate=!1}_=this.type,g.needsUpdate=!1,e.setRenderTarget(c,l,d)};function v(n,r){let a=t.update(h);f.defines.VSM_SAMPLES!==n.blurSamples&&(f.defines.VSM_SAMPLES=n.blurSamples,p.defines.VSM_SAMPLES=n.blurSamples,f.needsUpdate=!0,p.needsUpdate=!0),n.mapPass===null?n.mapPass=new Fr(i.x,i.y,{format:kt,type:gt}):(n.mapPass.width!==n.map.width||n.mapPass.height!==n.map.height)&&n.mapPass.setSize(n.map.width,n.map.height),f.uniforms.shadow_pass.value=n.map.depthTexture,f.uniforms.resolution.value.set(n.map.width,n.map.height),f.uniforms.radius.value=n.radius,e.setRenderTarget(n.mapPass),e.clear(),e.renderBufferDirect(r,null,a,f,h,null),p.uniforms.shadow_pass.value=n.mapPass.texture,p.uniforms.resolution.value.set(n.map.width,n.map.height),p.uniforms.radius.value=n.radius,e.setRenderTarget(n.map),e.clear(),e.renderBufferDirect(r,null,a,p,h,null)}function y(t,n,r,i){let a=null,o=r.isPointLight===!0?t.customDistanceMaterial:t.customDepthMaterial;if(o!==void 0)a=o;else if(a=r.isPointLight===!0?c:s,e.localClippingEnabled&&n.clipShadows===!0&&Array.isArray(n.clippingPlanes)&&n.clippingPlanes.length!==0||n.displacementMap&&n.displacementScale!==0||n.alphaMap&&n.alphaTest>0||n.map&&n.alphaTest>0||n.alphaToCoverage===!0){let e=a.uuid,t=n.uuid,r=l[e];r===void 0&&(r={},l[e]=r);let i=r[t];i===void 0&&(i=a.clone(),r[t]=i,n.addEventListener(`dispose`,x)),a=i}if(a.visible=n.visible,a.wireframe=n.wireframe,i===3?a.side=n.shadowSide===null?n.side:n.shadowSide:a.side=n.shadowSide===null?d[n.side]:n.shadowSide,a.alphaMap=n.alphaMap,a.alphaTest=n.alphaToCoverage===!0?.5:n.alphaTest,a.map=n.map,a.clipShadows=n.clipShadows,a.clippingPlanes=n.clippingPlanes,a.clipIntersection=n.clipIntersection,a.displacementMap=n.displacementMap,a.displacementScale=n.displacementScale,a.displacementBias=n.displacementBias,a.wireframeLinewidth=n.wireframeLinewidth,a.linewidth=n.linewidth,r.isPointLight===!0&&a.isMeshDistanceMaterial===!0){let t=e.properties.get(a);t.light=r}return a}function b(n,i,a,o,s,c){if(n.visible===!1)return;if(n.layers.test(s)&&(n.isMesh||n.isLine||n.isPoints)&&(n.castShadow||n.receiveShadow&&c===3)&&(!n.frustumCulled||n.intersectsFrustum(r))){n.modelViewMatrix.multiplyMatrices(a.matrixWorldInverse,n.matrixWorld);let r=t.update(n),s=n.material;if(Array.isArray(s)){let t=r.groups;for(let l=0,u=t.length;l<u;l++){let u=t[l],d=s[u.materialIndex];if(d&&d.visible){let t=y(n,d,o,c);n.onBeforeShadow(e,n,i,a,r,t,u),e.renderBufferDirect(a,null,r,t,n,u),n.onAfterShadow(e,n,i,a,r,t,u)}}}else if(s.visible){let t=y(n,s,o,c);n.onBeforeShadow(e,n,i,a,r,t,null),e.renderBufferDirect(a,null,r,t,n,null),n.onAfterShadow(e,n,i,a,r,t,null)}}let l=n.children;for(let e=0,t=l.length;e<t;e++)b(l[e],i,a,o,s,c)}function x(e){e.target.removeEventListener(`dispose`,x);for(let t in l){let n=l[t],r=e.target.uuid;r in n&&(n[r].dispose(),delete n[r])}}}function pf(e,t){function n(){let t=!1,n=new Nr,r=null,i=new Nr(0,0,0,0);return{setMask:function(n){r!==n&&!t&&(e.colorMask(n,n,n,n),r=n)},setLocked:function(e){t=e},setClear:function(t,r,a,o,s){s===!0&&(t*=o,r*=o,a*=o),n.set(t,r,a,o),i.equals(n)===!1&&(e.clearColor(t,r,a,o),i.copy(n))},reset:function(){t=!1,r=null,i.set(-1,0,0,0)}}}function r(){let n=!1,r=!1,i=null,a=null,o=null;return{setReversed:function(e){if(r!==e){let n=t.get(`EXT_clip_control`);e?n.clipControlEXT(n.LOWER_LEFT_EXT,n.ZERO_TO_ONE_EXT):n.clipControlEXT(n.LOWER_LEFT_EXT,n.NEGATIVE_ONE_TO_ONE_EXT),r=e;let i=o;o=null,this.setClear(i)}},getReversed:function(){return r},setTest:function(t){t?L(e.DEPTH_TEST):R(e.DEPTH_TEST)},setMask:function(t){i!==t&&!n&&(e.depthMask(t),i=t)},setFunc:function(t){if(r&&(t=Bn[t]),a!==t){switch(t){case 0:e.depthFunc(e.NEVER);break;case 1:e.depthFunc(e.ALWAYS);break;case 2:e.depthFunc(e.LESS);break;case 3:e.depthFunc(e.LEQUAL);break;case 4:e.depthFunc(e.EQUAL);break;case 5:e.depthFunc(e.GEQUAL);break;case 6:e.depthFunc(e.GREATER);break;case 7:e.depthFunc(e.NOTEQUAL);break;default:e.depthFunc(e.LEQUAL)}a=t}},setLocked:function(e){n=e},setClear:function(t){o!==t&&(o=t,r&&(t=1-t),e.clearDepth(t))},reset:function(){n=!1,i=null,a=null,o=null,r=!1}}}function i(){let t=!1,n=null,r=null,i=null,a=null,o=null,s=null,c=null,l=null;return{setTest:function(n){t||(n?L(e.STENCIL_TEST):R(e.STENCIL_TEST))},setMask:function(r){n!==r&&!t&&(e.stencilMask(r),n=r)},setFunc:function(t,n,o){(r!==t||i!==n||a!==o)&&(e.stencilFunc(t,n,o),r=t,i=n,a=o)},setOp:function(t,n,r){(o!==t||s!==n||c!==r)&&(e.stencilOp(t,n,r),o=t,s=n,c=r)},setLocked:function(e){t=e},setClear:function(t){l!==t&&(e.clearStencil(t),l=t)},reset:function(){t=!1,n=null,r=null,i=null,a=null,o=null,s=null,c=null,l=null}}}let a=new n,o=new r,s=new i,c={},l=new WeakMap,u={},d={},f={},p=new WeakMap,m=[],h=null,g=!1,_=null,v=null,y=null,b=null,x=null,S=null,C=null,w=new Y(0,0,0),T=0,E=!1,D=null,O=null,k=null,A=null,j=null,M=e.getParameter(e.MAX_COMBINED_TEXTURE_IMAGE_UNITS),N=!1,P=0,ee=e.getParameter(e.VERSION);ee.indexOf(`WebGL`)===-1?ee.indexOf(`OpenGL ES`)!==-1&&(P=parseFloat(/^OpenGL ES (\d)/.exec(ee)[1]),N=P>=2):(P=parseFloat(/^WebGL (\d)/.exec(ee)[1]),N=P>=1);let F=null,te={},ne=e.getParameter(e.SCISSOR_BOX),re=e.getParameter(e.VIEWPORT),ie=new Nr().fromArray(ne),I=new Nr().fromArray(re);function ae(t,n,r,i){let a=new Uint8Array(4),o=e.createTexture();e.bindTexture(t,o),e.texParameteri(t,e.TEXTURE_MIN_FILTER,e.NEAREST),e.texParameteri(t,e.TEXTURE_MAG_FILTER,e.NEAREST);for(let o=0;o<r;o++)t===e.TEXTURE_3D||t===e.TEXTURE_2D_ARRAY?e.texImage3D(n,0,e.RGBA,1,1,i,0,e.RGBA,e.UNSIGNED_BYTE,a):e.texImage2D(n+o,0,e.RGBA,1,1,0,e.RGBA,e.UNSIGNED_BYTE,a);return o}let oe={};oe[e.TEXTURE_2D]=ae(e.TEXTURE_2D,e.TEXTURE_2D,1),oe[e.TEXTURE_CUBE_MAP]=ae(e.TEXTURE_CUBE_MAP,e.TEXTURE_CUBE_MAP_POSITIVE_X,6),oe[e.TEXTURE_2D_ARRAY]=ae(e.TEXTURE_2D_ARRAY,e.TEXTURE_2D_ARRAY,1,1),oe[e.TEXTURE_3D]=ae(e.TEXTURE_3D,e.TEXTURE_3D,1,1),a.setClear(0,0,0,1),o.setClear(1),s.setClear(0),L(e.DEPTH_TEST),o.setFunc(3),me(!1),he(1),L(e.CULL_FACE),fe(0);function L(t){u[t]!==!0&&(e.enable(t),u[t]=!0)}function R(t){u[t]!==!1&&(e.disable(t),u[t]=!1)}function se(t,n){return f[t]!==n&&(e.bindFramebuffer(t,n),f[t]=n,t===e.DRAW_FRAMEBUFFER&&(f[e.FRAMEBUFFER]=n),t===e.FRAMEBUFFER&&(f[e.DRAW_FRAMEBUFFER]=n),!0)}function ce(t,n){let r=m,i=!1;if(t){r=p.get(n),r===void 0&&(r=[],p.set(n,r));let a=t.textures;if(r.length!==a.length||r[0]!==e.COLOR_ATTACHMENT0){for(let t=0,n=a.length;t<n;t++)r[t]=e.COLOR_ATTACHMENT0+t;r.length=a.length,i=!0}}else r[0]!==e.BACK&&(r[0]=e.BACK,i=!0);i&&e.drawBuffers(r)}function le(t){return h!==t&&(e.useProgram(t),h=t,!0)}let ue={100:e.FUNC_ADD,101:e.FUNC_SUBTRACT,102:e.FUNC_REVERSE_SUBTRACT};ue[103]=e.MIN,ue[104]=e.MAX;let de={200:e.ZERO,201:e.ONE,202:e.SRC_COLOR,204:e.SRC_ALPHA,210:e.SRC_ALPHA_SATURATE,208:e.DST_COLOR,206:e.DST_ALPHA,203:e.ONE_MINUS_SRC_COLOR,205:e.ONE_MINUS_SRC_ALPHA,209:e.ONE_MINUS_DST_COLOR,207:e.ONE_MINUS_DST_ALPHA,211:e.CONSTANT_COLOR,212:e.ONE_MINUS_CONSTANT_COLOR,213:e.CONSTANT_ALPHA,214:e.ONE_MINUS_CONSTANT_ALPHA};function fe(t,n,r,i,a,o,s,c,l,u){if(t===0)g===!0&&(R(e.BLEND),g=!1);else if(g===!1&&(L(e.BLEND),g=!0),t!==5){if(t!==_||u!==E){if((v!==100||x!==100)&&(e.blendEquation(e.FUNC_ADD),v=100,x=100),u)switch(t){case 1:e.blendFuncSeparate(e.ONE,e.ONE_MINUS_SRC_ALPHA,e.ONE,e.ONE_MINUS_SRC_ALPHA);break;case 2:e.blendFunc(e.ONE,e.ONE);break;case 3:e.blendFuncSeparate(e.ZERO,e.ONE_MINUS_SRC_COLOR,e.ZERO,e.ONE);break;case 4:e.blendFuncSeparate(e.DST_COLOR,e.ONE_MINUS_SRC_ALPHA,e.ZERO,e.ONE);break;default:W(`WebGLState: Invalid blending: `,t)}else switch(t){case 1:e.blendFuncSeparate(e.SRC_ALPHA,e.ONE_MINUS_SRC_ALPHA,e.ONE,e.ONE_MINUS_SRC_ALPHA);break;case 2:e.blendFuncSeparate(e.SRC_ALPHA,e.ONE,e.ONE,e.ONE);break;case 3:W(`WebGLState: SubtractiveBlending requires material.premultipliedAlpha = true`);break;case 4:W(`WebGLState: MultiplyBlending requires material.premultipliedAlpha = true`);break;default:W(`WebGLState: Invalid blending: `,t)}y=null,b=null,S=null,C=null,w.set(0,0,0),T=0,_=t,E=u}}else a||=n,o||=r,s||=i,(n!==v||a!==x)&&(e.blendEquationSeparate(ue[n],ue[a]),v=n,x=a),(r!==y||i!==b||o!==S||s!==C)&&(e.blendFuncSeparate(de[r],de[i],de[o],de[s]),y=r,b=i,S=o,C=s),(c.equals(w)===!1||l!==T)&&(e.blendColor(c.r,c.g,c.b,l),w.copy(c),T=l),_=t,E=!1}function pe(t,n){t.side===2?R(e.CULL_FACE):L(e.CULL_FACE);let r=t.side===1;n&&(r=!r),me(r),t.blending===1&&t.transparent===!1?fe(0):fe(t.blending,t.blendEquation,t.blendSrc,t.blendDst,t.blendEquationAlpha,t.blendSrcAlpha,t.blendDstAlpha,t.blendColor,t.blendAlpha,t.premultipliedAlpha),o.setFunc(t.depthFunc),o.setTest(t.depthTest),o.setMask(t.depthWrite),a.setMask(t.colorWrite);let i=t.stencilWrite;s.setTest(i),i&&(s.setMask(t.stencilWriteMask),s.setFunc(t.stencilFunc,t.stencilRef,t.stencilFuncMask),s.setOp(t.stencilFail,t.stencilZFail,t.stencilZPass)),_e(t.polygonOffset,t.polygonOffsetFactor,t.polygonOffsetUnits),t.alphaToCoverage===!0?L(e.SAMPLE_ALPHA_TO_COVERAGE):R(e.SAMPLE_ALPHA_TO_COVERAGE)}function me(t){D!==t&&(t?e.frontFace(e.CW):e.frontFace(e.CCW),D=t)}function he(t){t===0?R(e.CULL_FACE):(L(e.CULL_FACE),t!==O&&(t===1?e.cullFace(e.BACK):t===2?e.cullFace(e.FRONT):e.cullFace(e.FRONT_AND_BACK))),O=t}function ge(t){t!==k&&(N&&e.lineWidth(t),k=t)}function _e(t,n,r){t?(L(e.POLYGON_OFFSET_FILL),(A!==n||j!==r)&&(A=n,j=r,o.getReversed()&&(n=-n,r=-r),e.polygonOffset(n,r))):R(e.POLYGON_OFFSET_FILL)}function ve(t){t?L(e.SCISSOR_TEST):R(e.SCISSOR_TEST)}function ye(t){t===void 0&&(t=e.TEXTURE0+M-1),F!==t&&(e.activeTexture(t),F=t)}function z(t,n,r){r===void 0&&(r=F===null?e.TEXTURE0+M-1:F);let i=te[r];i===void 0&&(i={type:void 0,texture:void 0},te[r]=i),(i.type!==t||i.texture!==n)&&(F!==r&&(e.activeTexture(r),F=r),e.bindTexture(t,n||oe[t]),i.type=t,i.texture=n)}function be(){let t=te[F];t!==void 0&&t.type!==void 0&&(e.bindTexture(t.type,null),t.type=void 0,t.texture=void 0)}function xe(){try{e.compressedTexImage2D(...arguments)}catch(e){W(`WebGLState:`,e)}}function Se(){try{e.compressedTexImage3D(...arguments)}catch(e){W(`WebGLState:`,e)}}function B(){try{e.texSubImage2D(...arguments)}catch(e){W(`WebGLState:`,e)}}function Ce(){try{e.texSubImage3D(...arguments)}catch(e){W(`WebGLState:`,e)}}function V(){try{e.compressedTexSubImage2D(...arguments)}catch(e){W(`WebGLState:`,e)}}function H(){try{e.compressedTexSubImage3D(...arguments)}catch(e){W(`WebGLState:`,e)}}function we(){try{e.texStorage2D(...arguments)}catch(e){W(`WebGLState:`,e)}}function Te(){try{e.texStorage3D(...arguments)}catch(e){W(`WebGLState:`,e)}}function Ee(){try{e.texImage2D(...arguments)}catch(e){W(`WebGLState:`,e)}}function De(){try{e.texImage3D(...arguments)}catch(e){W(`WebGLState:`,e)}}function Oe(t){return d[t]===void 0?e.getParameter(t):d[t]}function ke(t,n){d[t]!==n&&(e.pixelStorei(t,n),d[t]=n)}function Ae(t){ie.equals(t)===!1&&(e.scissor(t.x,t.y,t.z,t.w),ie.copy(t))}function je(t){I.equals(t)===!1&&(e.viewport(t.x,t.y,t.z,t.w),I.copy(t))}function Me(t,n){let r=l.get(n);r===void 0&&(r=new WeakMap,l.set(n,r));let i=r.get(t);i===void 0&&(i=e.getUniformBlockIndex(n,t.name),e.uniformBlockBinding(n,i,i),r.set(t,i))}function Ne(t,n,r){let i=l.get(n).get(t);c[i]!==r&&(e.bindBufferBase(e.UNIFORM_BUFFER,i,r),c[i]=r)}function Pe(){e.disable(e.BLEND),e.disable(e.CULL_FACE),e.disable(e.DEPTH_TEST),e.disable(e.POLYGON_OFFSET_FILL),e.disable(e.SCISSOR_TEST),e.disable(e.STENCIL_TEST),e.disable(e.SAMPLE_ALPHA_TO_COVERAGE),e.blendEquation(e.FUNC_ADD),e.blendFunc(e.ONE,e.ZERO),e.blendFuncSeparate(e.ONE,e.ZERO,e.ONE,e.ZERO),e.blendColor(0,0,0,0),e.colorMask(!0,!0,!0,!0),e.clearColor(0,0,0,0),e.depthMask(!0),e.depthFunc(e.LESS),o.setReversed(!1),e.clearDepth(1),e.stencilMask(4294967295),e.stencilFunc(e.ALWAYS,0,4294967295),e.stencilOp(e.KEEP,e.KEEP,e.KEEP),e.clearStencil(0),e.cullFace(e.BACK),e.frontFace(e.CCW),e.polygonOffset(0,0),e.activeTexture(e.TEXTURE0),e.bindFramebuffer(e.FRAMEBUFFER,null),e.bindFramebuffer(e.DRAW_FRAMEBUFFER,null),e.bindFramebuffer(e.READ_FRAMEBUFFER,null),e.useProgram(null),e.lineWidth(1),e.scissor(0,0,e.canvas.width,e.canvas.height),e.viewport(0,0,e.canvas.width,e.canvas.height),e.pixelStorei(e.PACK_ALIGNMENT,4),e.pixelStorei(e.UNPACK_ALIGNMENT,4),e.pixelStorei(e.UNPACK_FLIP_Y_WEBGL,!1),e.pixelStorei(e.UNPACK_PREMULTIPLY_ALPHA_WEBGL,!1),e.pixelStorei(e.UNPACK_COLORSPACE_CONVERSION_WEBGL,e.BROWSER_DEFAULT_WEBGL),e.pixelStorei(e.PACK_ROW_LENGTH,0),e.pixelStorei(e.PACK_SKIP_PIXELS,0),e.pixelStorei(e.PACK_SKIP_ROWS,0),e.pixelStorei(e.UNPACK_ROW_LENGTH,0),e.pixelStorei(e.UNPACK_IMAGE_HEIGHT,0),e.pixelStorei(e.UNPACK_SKIP_PIXELS,0),e.pixelStorei(e.UNPACK_SKIP_ROWS,0),e.pixelStorei(e.UNPACK_SKIP_IMAGES,0),u={},d={},F=null,te={},f={},c={},p=new WeakMap,m=[],h=null,g=!1,_=null,v=null,y=null,b=null,x=null,S=null,C=null,w=new Y(0,0,0),T=0,E=!1,D=null,O=null,k=null,A=null,j=null,ie.set(0,0,e.canvas.width,e.canvas.height),I.set(0,0,e.canvas.width,e.canvas.height),a.reset(),o.reset(),s.reset()}return{buffers:{color:a,depth:o,stencil:s},enable:L,disable:R,bindFramebuffer:se,drawBuffers:ce,useProgram:le,setBlending:fe,setMaterial:pe,setFlipSided:me,setCullFace:he,setLineWidth:ge,setPolygonOffset:_e,setScissorTest:ve,activeTexture:ye,bindTexture:z,unbindTexture:be,compressedTexImage2D:xe,compressedTexImage3D:Se,texImage2D:Ee,texImage3D:De,pixelStorei:ke,getParameter:Oe,updateUBOMapping:Me,uniformBlockBinding:Ne,texStorage2D:we,texStorage3D:Te,texSubImage2D:B,texSubImage3D:Ce,compressedTexSubImage2D:V,compressedTexSubImage3D:H,scissor:Ae,viewport:je,reset:Pe}}function mf(e,t,n,r,i,a,o){let s=t.has(`WEBGL_multisampled_render_to_texture`)?t.get(`WEBGL_multisampled_render_to_texture`):null,c=typeof navigator>`u`?!1:/OculusBrowser/g.test(navigator.userAgent),l=new K,u=new WeakMap,d=new Set,f,p=new WeakMap,m=new Set,h=new FinalizationRegistry(e=>m.delete(e)),g=!1;try{g=typeof OffscreenCanvas<`u`&&new OffscreenCanvas(1,1).getContext(`2d`)!==null}catch{}function _(e,t){return g?new OffscreenCanvas(e,t):Nn(`canvas`)}function v(e,t,n){let r=1,i=we(e);if((i.width>n||i.height>n)&&(r=n/Math.max(i.width,i.height)),r<1){if(typeof HTMLImageElement<`u`&&e instanceof HTMLImageElement||typeof HTMLCanvasElement<`u`&&e instanceof HTMLCanvasElement||typeof ImageBitmap<`u`&&e instanceof ImageBitmap||typeof VideoFrame<`u`&&e instanceof VideoFrame){let n=Math.floor(r*i.width),a=Math.floor(r*i.height);f===void 0&&(f=_(n,a));let o=t?_(n,a):f;return o.width=n,o.height=a,o.getContext(`2d`).drawImage(e,0,0,n,a),U(`WebGLRenderer: Texture has been resized from (`+i.width+`x`+i.height+`) to (`+n+`x`+a+`).`),o}return`data`in e&&U(`WebGLRenderer: Image in DataTexture is too big (`+i.width+`x`+i.height+`).`),e}return e}function y(e){return e.generateMipmaps}function b(t){e.generateMipmap(t)}function x(t){return t.isWebGLCubeRenderTarget?e.TEXTURE_CUBE_MAP:t.isWebGL3DRenderTarget?e.TEXTURE_3D:t.isWebGLArrayRenderTarget||t.isCompressedArrayTexture?e.TEXTURE_2D_ARRAY:e.TEXTURE_2D}function S(n,r,i,a,o,s=!1){if(n!==null){if(e[n]!==void 0)return e[n];U(`WebGLRenderer: Attempt to use non-existing WebGL internal format '`+n+`'`)}let c;a&&(c=t.get(`EXT_texture_norm16`),c||U(`WebGLRenderer: Unable to use normalized textures without EXT_texture_norm16 extension`));let l=r;if(r===e.RED&&(i===e.FLOAT&&(l=e.R32F),i===e.HALF_FLOAT&&(l=e.R16F),i===e.UNSIGNED_BYTE&&(l=e.R8),i===e.UNSIGNED_SHORT&&c&&(l=c.R16_EXT),i===e.SHORT&&c&&(l=c.R16_SNORM_EXT)),r===e.RED_INTEGER&&(i===e.UNSIGNED_BYTE&&(l=e.R8UI),i===e.UNSIGNED_SHORT&&(l=e.R16UI),i===e.UNSIGNED_INT&&(l=e.R32UI),i===e.BYTE&&(l=e.R8I),i===e.SHORT&&(l=e.R16I),i===e.INT&&(l=e.R32I)),r===e.RG&&(i===e.FLOAT&&(l=e.RG32F),i===e.HALF_FLOAT&&(l=e.RG16F),i===e.UNSIGNED_BYTE&&(l=e.RG8),i===e.UNSIGNED_SHORT&&c&&(l=c.RG16_EXT),i===e.SHORT&&c&&(l=c.RG16_SNORM_EXT)),r===e.RG_INTEGER&&(i===e.UNSIGNED_BYTE&&(l=e.RG8UI),i===e.UNSIGNED_SHORT&&(l=e.RG16UI),i===e.UNSIGNED_INT&&(l=e.RG32UI),i===e.BYTE&&(l=e.RG8I),i===e.SHORT&&(l=e.RG16I),i===e.INT&&(l=e.RG32I)),r===e.RGB_INTEGER&&(i===e.UNSIGNED_BYTE&&(l=e.RGB8UI),i===e.UNSIGNED_SHORT&&(l=e.RGB16UI),i===e.UNSIGNED_INT&&(l=e.RGB32UI),i===e.BYTE&&(l=e.RGB8I),i===e.SHORT&&(l=e.RGB16I),i===e.INT&&(l=e.RGB32I)),r===e.RGBA_INTEGER&&(i===e.UNSIGNED_BYTE&&(l=e.RGBA8UI),i===e.UNSIGNED_SHORT&&(l=e.RGBA16UI),i===e.UNSIGNED_INT&&(l=e.RGBA32UI),i===e.BYTE&&(l=e.RGBA8I),i===e.SHORT&&(l=e.RGBA16I),i===e.INT&&(l=e.RGBA32I)),r===e.RGB&&(i===e.UNSIGNED_SHORT&&c&&(l=c.RGB16_EXT),i===e.SHORT&&c&&(l=c.RGB16_SNORM_EXT),i===e.UNSIGNED_INT_5_9_9_9_REV&&(l=e.RGB9_E5),i===e.UNSIGNED_INT_10F_11F_11F_REV&&(l=e.R11F_G11F_B10F)),r===e.RGBA){let t=s?Tn:Sr.getTransfer(o);i===e.FLOAT&&(l=e.RGBA32F),i===e.HALF_FLOAT&&(l=e.RGBA16F),i===e.UNSIGNED_BYTE&&(l=t===`srgb`?e.SRGB8_ALPHA8:e.RGBA8),i===e.UNSIGNED_SHORT&&c&&(l=c.RGBA16_EXT),i===e.SHORT&&c&&(l=c.RGBA16_SNORM_EXT),i===e.UNSIGNED_SHORT_4_4_4_4&&(l=e.RGBA4),i===e.UNSIGNED_SHORT_5_5_5_1&&(l=e.RGB5_A1)}return(l===e.R16F||l===e.R32F||l===e.RG16F||l===e.RG32F||l===e.RGBA16F||l===e.RGBA32F)&&t.get(`EXT_color_buffer_float`),l}function C(t,n){let r;return t?n===null||n===1014||n===1020?r=e.DEPTH24_STENCIL8:n===1015?r=e.DEPTH32F_STENCIL8:n===1012&&(r=e.DEPTH24_STENCIL8,U(`DepthTexture: 16 bit depth attachment is not supported with stencil. Using 24-bit attachment.`)):n===null||n===1014||n===1020?r=e.DEPTH_COMPONENT24:n===1015?r=e.DEPTH_COMPONENT32F:n===1012&&(r=e.DEPTH_COMPONENT16),r}function w(e,t){return y(e)===!0||e.isFramebufferTexture&&e.minFilter!==1003&&e.minFilter!==1006?Math.log2(Math.max(t.width,t.height))+1:e.mipmaps.length>0?e.mipmaps.length:e.isCompressedTexture&&Array.isArray(e.image)?t.mipmaps.length:1}function T(e){let t=new WeakRef(e);r.get(e).__ref=t,m.add(t),h.register(e,t,t)}function E(e){let t=r.get(e).__ref;t!==void 0&&(m.delete(t),h.unregister(t))}function D(e){k(e.target)}function O(e){A(e.target)}function k(e){e.removeEventListener(`dispose`,D),E(e),M(e),e.isVideoTexture&&u.delete(e),e.isHTMLTexture&&d.delete(e)}function A(e){e.removeEventListener(`dispose`,O),E(e),P(e)}function j(){for(let e of m){let t=e.deref();t!==void 0&&(t.isRenderTarget===!0?A(t):k(t))}m.clear(),d.clear()}function M(e){let t=r.get(e);if(t.__webglInit===void 0)return;let n=e.source,i=p.get(n);if(i){let r=i[t.__cacheKey];r.usedTimes--,r.usedTimes===0&&N(e),Object.keys(i).length===0&&p.delete(n)}r.remove(e)}function N(t){let n=r.get(t);e.deleteTexture(n.__webglTexture);let i=t.source,a=p.get(i);delete a[n.__cacheKey],o.memory.textures--}function P(t){let n=r.get(t);n.__depthDisposeCallback&&n.__depthDisposeCallback();let i=t.depthTexture;if(i&&i.renderTarget===t&&k(i),t.isWebGLCubeRenderTarget)for(let t=0;t<6;t++){if(Array.isArray(n.__webglFramebuffer[t]))for(let r=0;r<n.__webglFramebuffer[t].length;r++)e.deleteFramebuffer(n.__webglFramebuffer[t][r]);else e.deleteFramebuffer(n.__webglFramebuffer[t]);n.__webglDepthbuffer&&e.deleteRenderbuffer(n.__webglDepthbuffer[t])}else{if(Array.isArray(n.__webglFramebuffer))for(let t=0;t<n.__webglFramebuffer.length;t++)e.deleteFramebuffer(n.__webglFramebuffer[t]);else e.deleteFramebuffer(n.__webglFramebuffer);if(n.__webglDepthbuffer&&e.deleteRenderbuffer(n.__webglDepthbuffer),n.__webglMultisampledFramebuffer&&e.deleteFramebuffer(n.__webglMultisampledFramebuffer),n.__webglColorRenderbuffer)for(let t=0;t<n.__webglColorRenderbuffer.length;t++)n.__webglColorRenderbuffer[t]&&e.deleteRenderbuffer(n.__webglColorRenderbuffer[t]);n.__webglDepthRenderbuffer&&e.deleteRenderbuffer(n.__webglDepthRenderbuffer)}let a=t.textures;for(let t=0,n=a.length;t<n;t++){let n=r.get(a[t]);n.__webglTexture&&(e.deleteTexture(n.__webglTexture),o.memory.textures--),r.remove(a[t])}r.remove(t)}let ee=0;function F(){ee=0}function te(){return ee}function ne(e){ee=e}function re(){let e=ee;return e>=i.maxTextures&&U(`WebGLTextures: Trying to use `+(e+1)+` texture units while this GPU supports only `+i.maxTextures),ee+=1,e}function ie(e){let t=[];return t.push(e.wrapS),t.push(e.wrapT),t.push(e.wrapR||0),t.push(e.magFilter),t.push(e.minFilter),t.push(e.anisotropy),t.push(e.internalFormat),t.push(e.format),t.push(e.type),t.push(e.generateMipmaps),t.push(e.mipmapsAutoUpdate),t.push(e.premultiplyAlpha),t.push(e.flipY),t.push(e.unpackAlignment),t.push(e.colorSpace),t.join()}function I(t,i){let a=r.get(t);if(t.isVideoTexture&&V(t),t.isRenderTargetTexture===!1&&t.isExternalTexture!==!0&&t.version>0&&a.__version!==t.version){let e=t.image;if(e===null)U(`WebGLRenderer: Texture marked for update but no image data found.`);else if(e.complete===!1)U(`WebGLRenderer: Texture marked for update but image is incomplete`);else{pe(a,t,i);return}}else t.isExternalTexture&&(a.__webglTexture=t.sourceTexture?t.sourceTexture:null);n.bindTexture(e.TEXTURE_2D,a.__webglTexture,e.TEXTURE0+i)}function ae(t,i){let a=r.get(t);t.isRenderTargetTexture===!1&&t.version>0&&a.__version!==t.version?pe(a,t,i):(t.isExternalTexture&&(a.__webglTexture=t.sourceTexture?t.sourceTexture:null),n.bindTexture(e.TEXTURE_2D_ARRAY,a.__webglTexture,e.TEXTURE0+i))}function oe(t,i){let a=r.get(t);t.isRenderTargetTexture===!1&&t.version>0&&a.__version!==t.version?pe(a,t,i):n.bindTexture(e.TEXTURE_3D,a.__webglTexture,e.TEXTURE0+i)}function L(t,i){let a=r.get(t);t.version>0&&a.__version!==t.version?me(a,t,i):n.bindTexture(e.TEXTURE_CUBE_MAP,a.__webglTexture,e.TEXTURE0+i)}let R={[et]:e.REPEAT,[tt]:e.CLAMP_TO_EDGE,[nt]:e.MIRRORED_REPEAT},se={[rt]:e.NEAREST,[it]:e.NEAREST_MIPMAP_NEAREST,[at]:e.NEAREST_MIPMAP_LINEAR,[ot]:e.LINEAR,[st]:e.LINEAR_MIPMAP_NEAREST,[ct]:e.LINEAR_MIPMAP_LINEAR},ce={512:e.NEVER,519:e.ALWAYS,513:e.LESS,515:e.LEQUAL,514:e.EQUAL,518:e.GEQUAL,516:e.GREATER,517:e.NOTEQUAL};function le(n,a){if(a.type===1015&&t.has(`OES_texture_float_linear`)===!1&&(a.magFilter===1006||a.magFilter===1007||a.magFilter===1005||a.magFilter===1008||a.minFilter===1006||a.minFilter===1007||a.minFilter===1005||a.minFilter===1008)&&U(`WebGLRenderer: Unable to use linear filtering with floating point textures. OES_texture_float_linear not supported on this device.`),e.texParameteri(n,e.TEXTURE_WRAP_S,R[a.wrapS]),e.texParameteri(n,e.TEXTURE_WRAP_T,R[a.wrapT]),(n===e.TEXTURE_3D||n===e.TEXTURE_2D_ARRAY)&&e.texParameteri(n,e.TEXTURE_WRAP_R,R[a.wrapR]),e.texParameteri(n,e.TEXTURE_MAG_FILTER,se[a.magFilter]),e.texParameteri(n,e.TEXTURE_MIN_FILTER,se[a.minFilter]),a.compareFunction&&(e.texParameteri(n,e.TEXTURE_COMPARE_MODE,e.COMPARE_REF_TO_TEXTURE),e.texParameteri(n,e.TEXTURE_COMPARE_FUNC,ce[a.compareFunction])),t.has(`EXT_texture_filter_anisotropic`)===!0){if(a.magFilter===1003||a.minFilter!==1005&&a.minFilter!==1008||a.type===1015&&t.has(`OES_texture_float_linear`)===!1)return;if(a.anisotropy>1||r.get(a).__currentAnisotropy){let o=t.get(`EXT_texture_filter_anisotropic`);e.texParameterf(n,o.TEXTURE_MAX_ANISOTROPY_EXT,Math.min(a.anisotropy,i.getMaxAnisotropy())),r.get(a).__currentAnisotropy=a.anisotropy}}}function ue(t,n){let r=!1;t.__webglInit===void 0&&(t.__webglInit=!0,n.addEventListener(`dispose`,D),T(n));let i=n.source,a=p.get(i);a===void 0&&(a={},p.set(i,a));let s=ie(n);if(s!==t.__cacheKey){a[s]===void 0&&(a[s]={texture:e.createTexture(),usedTimes:0},o.memory.textures++,r=!0),a[s].usedTimes++;let i=a[t.__cacheKey];i!==void 0&&(a[t.__cacheKey].usedTimes--,i.usedTimes===0&&N(n)),t.__cacheKey=s,t.__webglTexture=a[s].texture}return r}function de(e,t,n){return Math.floor(Math.floor(e/n)/t)}function fe(t,r,i,a){let o=t.updateRanges;if(o.length===0)n.texSubImage2D(e.TEXTURE_2D,0,0,0,r.width,r.height,i,a,r.data);else{o.sort((e,t)=>e.start-t.start);let s=0;for(let e=1;e<o.length;e++){let t=o[s],n=o[e],i=t.start+t.count,a=de(n.start,r.width,4),c=de(t.start,r.width,4);n.start<=i+1&&a===c&&de(n.start+n.count-1,r.width,4)===a?t.count=Math.max(t.count,n.start+n.count-t.start):(++s,o[s]=n)}o.length=s+1;let c=n.getParameter(e.UNPACK_ROW_LENGTH),l=n.getParameter(e.UNPACK_SKIP_PIXELS),u=n.getParameter(e.UNPACK_SKIP_ROWS);n.pixelStorei(e.UNPACK_ROW_LENGTH,r.width);for(let t=0,s=o.length;t<s;t++){let s=o[t],c=Math.floor(s.start/4),l=Math.ceil(s.count/4),u=c%r.width,d=Math.floor(c/r.width),f=l;n.pixelStorei(e.UNPACK_SKIP_PIXELS,u),n.pixelStorei(e.UNPACK_SKIP_ROWS,d),n.texSubImage2D(e.TEXTURE_2D,0,u,d,f,1,i,a,r.data)}t.clearUpdateRanges(),n.pixelStorei(e.UNPACK_ROW_LENGTH,c),n.pixelStorei(e.UNPACK_SKIP_PIXELS,l),n.pixelStorei(e.UNPACK_SKIP_ROWS,u)}}function pe(t,o,s){let c=e.TEXTURE_2D;(o.isDataArrayTexture||o.isCompressedArrayTexture)&&(c=e.TEXTURE_2D_ARRAY),o.isData3DTexture&&(c=e.TEXTURE_3D);let l=ue(t,o),u=o.source;n.bindTexture(c,t.__webglTexture,e.TEXTURE0+s);let f=r.get(u);if(u.version!==f.__version||l===!0){if(n.activeTexture(e.TEXTURE0+s),!(typeof ImageBitmap<`u`&&o.image instanceof ImageBitmap)){let t=Sr.getPrimaries(Sr.workingColorSpace),r=o.colorSpace===``?null:Sr.getPrimaries(o.colorSpace),i=o.colorSpace===``||t===r?e.NONE:e.BROWSER_DEFAULT_WEBGL;n.pixelStorei(e.UNPACK_FLIP_Y_WEBGL,o.flipY),n.pixelStorei(e.UNPACK_PREMULTIPLY_ALPHA_WEBGL,o.premultiplyAlpha),n.pixelStorei(e.UNPACK_COLORSPACE_CONVERSION_WEBGL,i)}n.pixelStorei(e.UNPACK_ALIGNMENT,o.unpackAlignment);let t=v(o.image,!1,i.maxTextureSize);t=H(o,t);let r=a.convert(o.format,o.colorSpace),p=a.convert(o.type),m=S(o.internalFormat,r,p,o.normalized,o.colorSpace,o.isVideoTexture);le(c,o);let h,g=o.mipmaps,_=o.isVideoTexture!==!0,x=f.__version===void 0||l===!0,T=u.dataReady,E=w(o,t);if(o.isDepthTexture)m=C(o.format===Et,o.type),x&&(_?n.texStorage2D(e.TEXTURE_2D,1,m,t.width,t.height):n.texImage2D(e.TEXTURE_2D,0,m,t.width,t.height,0,r,p,null));else if(o.isDataTexture){if(g.length>0){_&&x&&n.texStorage2D(e.TEXTURE_2D,E,m,g[0].width,g[0].height);for(let t=0,i=g.length;t<i;t++)h=g[t],_?T&&n.texSubImage2D(e.TEXTURE_2D,t,0,0,h.width,h.height,r,p,h.data):n.texImage2D(e.TEXTURE_2D,t,m,h.width,h.height,0,r,p,h.data);o.generateMipmaps=!1}else _?(x&&n.texStorage2D(e.TEXTURE_2D,E,m,t.width,t.height),T&&fe(o,t,r,p)):n.texImage2D(e.TEXTURE_2D,0,m,t.width,t.height,0,r,p,t.data)}else if(o.isCompressedTexture){if(o.isCompressedArrayTexture){_&&x&&n.texStorage3D(e.TEXTURE_2D_ARRAY,E,m,g[0].width,g[0].height,t.depth);for(let i=0,a=g.length;i<a;i++)if(h=g[i],o.format!==1023){if(r!==null){if(_){if(T){if(o.layerUpdates.size>0){let t=hl(h.width,h.height,o.format,o.type);for(let a of o.layerUpdates){let o=h.data.subarray(a*t/h.data.BYTES_PER_ELEMENT,(a+1)*t/h.data.BYTES_PER_ELEMENT);n.compressedTexSubImage3D(e.TEXTURE_2D_ARRAY,i,0,0,a,h.width,h.height,1,r,o)}}else n.compressedTexSubImage3D(e.TEXTURE_2D_ARRAY,i,0,0,0,h.width,h.height,t.depth,r,h.data)}}else n.compressedTexImage3D(e.TEXTURE_2D_ARRAY,i,m,h.width,h.height,t.depth,0,h.data,0,0)}else U(`WebGLRenderer: Attempt to load unsupported compressed texture format in .uploadTexture()`)}else _?T&&n.texSubImage3D(e.TEXTURE_2D_ARRAY,i,0,0,0,h.width,h.height,t.depth,r,p,h.data):n.texImage3D(e.TEXTURE_2D_ARRAY,i,m,h.width,h.height,t.depth,0,r,p,h.data);o.layerUpdates.size>0&&o.clearLayerUpdates()}else{_&&x&&n.texStorage2D(e.TEXTURE_2D,E,m,g[0].width,g[0].height);for(let t=0,i=g.length;t<i;t++)h=g[t],o.format===1023?_?T&&n.texSubImage2D(e.TEXTURE_2D,t,0,0,h.width,h.height,r,p,h.data):n.texImage2D(e.TEXTURE_2D,t,m,h.width,h.height,0,r,p,h.data):r===null?U(`WebGLRenderer: Attempt to load unsupported compressed texture format in .uploadTexture()`):_?T&&n.compressedTexSubImage2D(e.TEXTURE_2D,t,0,0,h.width,h.height,r,h.data):n.compressedTexImage2D(e.TEXTURE_2D,t,m,h.width,h.height,0,h.data)}}else if(o.isDataArrayTexture){if(_){if(x&&n.texStorage3D(e.TEXTURE_2D_ARRAY,E,m,t.width,t.height,t.depth),T){if(o.layerUpdates.size>0){let i=hl(t.width,t.height,o.format,o.type);for(let a of o.layerUpdates){let o=t.data.subarray(a*i/t.data.BYTES_PER_ELEMENT,(a+1)*i/t.data.BYTES_PER_ELEMENT);n.texSubImage3D(e.TEXTURE_2D_ARRAY,0,0,0,a,t.width,t.height,1,r,p,o)}o.clearLayerUpdates()}else n.texSubImage3D(e.TEXTURE_2D_ARRAY,0,0,0,0,t.width,t.height,t.depth,r,p,t.data)}}else n.texImage3D(e.TEXTURE_2D_ARRAY,0,m,t.width,t.height,t.depth,0,r,p,t.data)}else if(o.isData3DTexture)_?(x&&n.texStorage3D(e.TEXTURE_3D,E,m,t.width,t.height,t.depth),T&&n.texSubImage3D(e.TEXTURE_3D,0,0,0,0,t.width,t.height,t.depth,r,p,t.data)):n.texImage3D(e.TEXTURE_3D,0,m,t.width,t.height,t.depth,0,r,p,t.data);else if(o.isFramebufferTexture){if(x){if(_)n.texStorage2D(e.TEXTURE_2D,E,m,t.width,t.height);else{let i=t.width,a=t.height;for(let t=0;t<E;t++)n.texImage2D(e.TEXTURE_2D,t,m,i,a,0,r,p,null),i>>=1,a>>=1}}}else if(o.isHTMLTexture){if(`texElementImage2D`in e){let n=e.canvas;if(n.hasAttribute(`layoutsubtree`)||n.setAttribute(`layoutsubtree`,`true`),t.parentNode!==n){n.appendChild(t),d.add(o),n.onpaint=e=>{let t=e.changedElements;for(let e of d)t.includes(e.image)&&(e.needsUpdate=!0)},n.requestPaint();return}if(e.texElementImage2D.length===3)e.texElementImage2D(e.TEXTURE_2D,e.RGBA8,t);else{let n=e.RGBA,r=e.RGBA,i=e.UNSIGNED_BYTE;e.texElementImage2D(e.TEXTURE_2D,0,n,r,i,t)}e.texParameteri(e.TEXTURE_2D,e.TEXTURE_MIN_FILTER,e.LINEAR),e.texParameteri(e.TEXTURE_2D,e.TEXTURE_WRAP_S,e.CLAMP_TO_EDGE),e.texParameteri(e.TEXTURE_2D,e.TEXTURE_WRAP_T,e.CLAMP_TO_EDGE)}}else if(g.length>0){if(_&&x){let t=we(g[0]);n.texStorage2D(e.TEXTURE_2D,E,m,t.width,t.height)}for(let t=0,i=g.length;t<i;t++)h=g[t],_?T&&n.texSubImage2D(e.TEXTURE_2D,t,0,0,r,p,h):n.texImage2D(e.TEXTURE_2D,t,m,r,p,h);o.generateMipmaps=!1}else if(_){if(x){let r=we(t);n.texStorage2D(e.TEXTURE_2D,E,m,r.width,r.height)}T&&n.texSubImage2D(e.TEXTURE_2D,0,0,0,r,p,t)}else n.texImage2D(e.TEXTURE_2D,0,m,r,p,t);y(o)&&o.mipmapsAutoUpdate===!0&&b(c),f.__version=u.version,o.onUpdate&&o.onUpdate(o)}t.__version=o.version}function me(t,o,s){if(o.image.length!==6)return;let c=ue(t,o),l=o.source;n.bindTexture(e.TEXTURE_CUBE_MAP,t.__webglTexture,e.TEXTURE0+s);let u=r.get(l);if(l.version!==u.__version||c===!0){n.activeTexture(e.TEXTURE0+s);let t=Sr.getPrimaries(Sr.workingColorSpace),r=o.colorSpace===``?null:Sr.getPrimaries(o.colorSpace),d=o.colorSpace===``||t===r?e.NONE:e.BROWSER_DEFAULT_WEBGL;n.pixelStorei(e.UNPACK_FLIP_Y_WEBGL,o.flipY),n.pixelStorei(e.UNPACK_PREMULTIPLY_ALPHA_WEBGL,o.premultiplyAlpha),n.pixelStorei(e.UNPACK_ALIGNMENT,o.unpackAlignment),n.pixelStorei(e.UNPACK_COLORSPACE_CONVERSION_WEBGL,d);let f=o.isCompressedTexture||o.image[0].isCompressedTexture,p=o.image[0]&&o.image[0].isDataTexture,m=[];for(let e=0;e<6;e++)!f&&!p?m[e]=v(o.image[e],!0,i.maxCubemapSize):m[e]=p?o.image[e].image:o.image[e],m[e]=H(o,m[e]);let h=m[0],g=a.convert(o.format,o.colorSpace),_=a.convert(o.type),x=S(o.internalFormat,g,_,o.normalized,o.colorSpace),T=o.isVideoTexture!==!0,E=u.__version===void 0||c===!0,D=l.dataReady,O=w(o,h);le(e.TEXTURE_CUBE_MAP,o);let k;if(o.isDepthTexture){if(x=C(o.format===Et,o.type),E){if(T)n.texStorage2D(e.TEXTURE_CUBE_MAP,1,x,h.width,h.height);else for(let t=0;t<6;t++)n.texImage2D(e.TEXTURE_CUBE_MAP_POSITIVE_X+t,0,x,h.width,h.height,0,g,_,null)}}else if(f){T&&E&&n.texStorage2D(e.TEXTURE_CUBE_MAP,O,x,h.width,h.height);for(let t=0;t<6;t++){k=m[t].mipmaps;for(let r=0;r<k.length;r++){let i=k[r];o.format===1023?T?D&&n.texSubImage2D(e.TEXTURE_CUBE_MAP_POSITIVE_X+t,r,0,0,i.width,i.height,g,_,i.data):n.texImage2D(e.TEXTURE_CUBE_MAP_POSITIVE_X+t,r,x,i.width,i.height,0,g,_,i.data):g===null?U(`WebGLRenderer: Attempt to load unsupported compressed texture format in .setTextureCube()`):T?D&&n.compressedTexSubImage2D(e.TEXTURE_CUBE_MAP_POSITIVE_X+t,r,0,0,i.width,i.height,g,i.data):n.compressedTexImage2D(e.TEXTURE_CUBE_MAP_POSITIVE_X+t,r,x,i.width,i.height,0,i.data)}}}else{if(k=o.mipmaps,T&&E){k.length>0&&O++;let t=we(m[0]);n.texStorage2D(e.TEXTURE_CUBE_MAP,O,x,t.width,t.height)}for(let t=0;t<6;t++)if(p){T?D&&n.texSubImage2D(e.TEXTURE_CUBE_MAP_POSITIVE_X+t,0,0,0,m[t].width,m[t].height,g,_,m[t].data):n.texImage2D(e.TEXTURE_CUBE_MAP_POSITIVE_X+t,0,x,m[t].width,m[t].height,0,g,_,m[t].data);for(let r=0;r<k.length;r++){let i=k[r].image[t].image;T?D&&n.texSubImage2D(e.TEXTURE_CUBE_MAP_POSITIVE_X+t,r+1,0,0,i.width,i.height,g,_,i.data):n.texImage2D(e.TEXTURE_CUBE_MAP_POSITIVE_X+t,r+1,x,i.width,i.height,0,g,_,i.data)}}else{T?D&&n.texSubImage2D(e.TEXTURE_CUBE_MAP_POSITIVE_X+t,0,0,0,g,_,m[t]):n.texImage2D(e.TEXTURE_CUBE_MAP_POSITIVE_X+t,0,x,g,_,m[t]);for(let r=0;r<k.length;r++){let i=k[r];T?D&&n.texSubImage2D(e.TEXTURE_CUBE_MAP_POSITIVE_X+t,r+1,0,0,g,_,i.image[t]):n.texImage2D(e.TEXTURE_CUBE_MAP_POSITIVE_X+t,r+1,x,g,_,i.image[t])}}}y(o)&&o.mipmapsAutoUpdate===!0&&b(e.TEXTURE_CUBE_MAP),u.__version=l.version,o.onUpdate&&o.onUpdate(o)}t.__version=o.version}function he(t,i,o,c,l,u){let d=a.convert(o.format,o.colorSpace),f=a.convert(o.type),p=S(o.internalFormat,d,f,o.normalized,o.colorSpace),m=r.get(i),h=r.get(o);if(h.__renderTarget=i,!m.__hasExternalTextures){let t=Math.max(1,i.width>>u),r=Math.max(1,i.height>>u);l===e.TEXTURE_3D||l===e.TEXTURE_2D_ARRAY?n.texImage3D(l,u,p,t,r,i.depth,0,d,f,null):n.texImage2D(l,u,p,t,r,0,d,f,null)}n.bindFramebuffer(e.FRAMEBUFFER,t),Ce(i)?s.framebufferTexture2DMultisampleEXT(e.FRAMEBUFFER,c,l,h.__webglTexture,0,B(i)):(l===e.TEXTURE_2D||l>=e.TEXTURE_CUBE_MAP_POSITIVE_X&&l<=e.TEXTURE_CUBE_MAP_NEGATIVE_Z)&&e.framebufferTexture2D(e.FRAMEBUFFER,c,l,h.__webglTexture,u),n.bindFramebuffer(e.FRAMEBUFFER,null)}function ge(t,n,r){if(e.bindRenderbuffer(e.RENDERBUFFER,t),n.depthBuffer){let i=n.depthTexture,a=i&&i.isDepthTexture?i.type:null,o=C(n.stencilBuffer,a),c=n.stencilBuffer?e.DEPTH_STENCIL_ATTACHMENT:e.DEPTH_ATTACHMENT;Ce(n)?s.renderbufferStorageMultisampleEXT(e.RENDERBUFFER,B(n),o,n.width,n.height):r?e.renderbufferStorageMultisample(e.RENDERBUFFER,B(n),o,n.width,n.height):e.renderbufferStorage(e.RENDERBUFFER,o,n.width,n.height),e.framebufferRenderbuffer(e.FRAMEBUFFER,c,e.RENDERBUFFER,t)}else{let t=n.textures;for(let i=0;i<t.length;i++){let o=t[i],c=a.convert(o.format,o.colorSpace),l=a.convert(o.type),u=S(o.internalFormat,c,l,o.normalized,o.colorSpace);Ce(n)?s.renderbufferStorageMultisampleEXT(e.RENDERBUFFER,B(n),u,n.width,n.height):r?e.renderbufferStorageMultisample(e.RENDERBUFFER,B(n),u,n.width,n.height):e.renderbufferStorage(e.RENDERBUFFER,u,n.width,n.height)}}e.bindRenderbuffer(e.RENDERBUFFER,null)}function _e(t,i,a){let o=i.isWebGLCubeRenderTarget===!0;if(n.bindFramebuffer(e.FRAMEBUFFER,t),!(i.depthTexture&&i.depthTexture.isDepthTexture))throw Error(`THREE.WebGLTextures: renderTarget.depthTexture must be an instance of THREE.DepthTexture.`);let c=r.get(i.depthTexture);c.__renderTarget=i;let l=o?i.depthTexture.image[0]:i.depthTexture.image;c.__webglTexture&&l.width===i.width&&l.height===i.height||(l.width=i.width,l.height=i.height,i.depthTexture.needsUpdate=!0),o?L(i.depthTexture,0):I(i.depthTexture,0);let u=c.__webglTexture,d=B(i),f=o?e.TEXTURE_CUBE_MAP_POSITIVE_X+a:e.TEXTURE_2D,p=i.depthTexture.format===1027?e.DEPTH_STENCIL_ATTACHMENT:e.DEPTH_ATTACHMENT;if(i.depthTexture.format===1026)Ce(i)?s.framebufferTexture2DMultisampleEXT(e.FRAMEBUFFER,p,f,u,0,d):e.framebufferTexture2D(e.FRAMEBUFFER,p,f,u,0);else if(i.depthTexture.format===1027)Ce(i)?s.framebufferTexture2DMultisampleEXT(e.FRAMEBUFFER,p,f,u,0,d):e.framebufferTexture2D(e.FRAMEBUFFER,p,f,u,0);else throw Error(`THREE.WebGLTextures: Unknown depthTexture format.`)}function ve(t){let i=r.get(t),a=t.isWebGLCubeRenderTarget===!0;if(i.__boundDepthTexture!==t.depthTexture){let e=t.depthTexture;if(i.__depthDisposeCallback&&i.__depthDisposeCallback(),e){let t=()=>{delete i.__boundDepthTexture,delete i.__depthDisposeCallback,e.removeEventListener(`dispose`,t)};e.addEventListener(`dispose`,t),i.__depthDisposeCallback=t}i.__boundDepthTexture=e}if(t.depthTexture&&!i.__autoAllocateDepthBuffer){if(a)for(let e=0;e<6;e++)_e(i.__webglFramebuffer[e],t,e);else t.texture.mipmaps.length>0?_e(i.__webglFramebuffer[0],t,0):_e(i.__webglFramebuffer,t,0)}else if(a){i.__webglDepthbuffer=[];for(let r=0;r<6;r++)if(n.bindFramebuffer(e.FRAMEBUFFER,i.__webglFramebuffer[r]),i.__webglDepthbuffer[r]===void 0)i.__webglDepthbuffer[r]=e.createRenderbuffer(),ge(i.__webglDepthbuffer[r],t,!1);else{let n=t.stencilBuffer?e.DEPTH_STENCIL_ATTACHMENT:e.DEPTH_ATTACHMENT,a=i.__webglDepthbuffer[r];e.bindRenderbuffer(e.RENDERBUFFER,a),e.framebufferRenderbuffer(e.FRAMEBUFFER,n,e.RENDERBUFFER,a)}}else if(t.texture.mipmaps.length>0?n.bindFramebuffer(e.FRAMEBUFFER,i.__webglFramebuffer[0]):n.bindFramebuffer(e.FRAMEBUFFER,i.__webglFramebuffer),i.__webglDepthbuffer===void 0)i.__webglDepthbuffer=e.createRenderbuffer(),ge(i.__webglDepthbuffer,t,!1);else{let n=t.stencilBuffer?e.DEPTH_STENCIL_ATTACHMENT:e.DEPTH_ATTACHMENT,r=i.__webglDepthbuffer;e.bindRenderbuffer(e.RENDERBUFFER,r),e.framebufferRenderbuffer(e.FRAMEBUFFER,n,e.RENDERBUFFER,r)}n.bindFramebuffer(e.FRAMEBUFFER,null)}function ye(t,n,i){let a=r.get(t);n!==void 0&&he(a.__webglFramebuffer,t,t.texture,e.COLOR_ATTACHMENT0,e.TEXTURE_2D,0),i!==void 0&&ve(t)}function z(t){let i=t.texture,s=r.get(t),c=r.get(i);t.addEventListener(`dispose`,O),T(t);let l=t.textures,u=t.isWebGLCubeRenderTarget===!0,d=l.length>1;if(d||(c.__webglTexture===void 0&&(c.__webglTexture=e.createTexture()),c.__version=i.version,o.memory.textures++),u){s.__webglFramebuffer=[];for(let t=0;t<6;t++)if(i.mipmaps.length>0){s.__webglFramebuffer[t]=[];for(let n=0;n<i.mipmaps.length;n++)s.__webglFramebuffer[t][n]=e.createFramebuffer()}else s.__webglFramebuffer[t]=e.createFramebuffer()}else{if(i.mipmaps.length>0){s.__webglFramebuffer=[];for(let t=0;t<i.mipmaps.length;t++)s.__webglFramebuffer[t]=e.createFramebuffer()}else s.__webglFramebuffer=e.createFramebuffer();if(d)for(let t=0,n=l.length;t<n;t++){let n=r.get(l[t]);n.__webglTexture===void 0&&(n.__webglTexture=e.createTexture(),o.memory.textures++)}if(t.samples>0&&Ce(t)===!1){s.__webglMultisampledFramebuffer=e.createFramebuffer(),s.__webglColorRenderbuffer=[],n.bindFramebuffer(e.FRAMEBUFFER,s.__webglMultisampledFramebuffer);for(let n=0;n<l.length;n++){let r=l[n];s.__webglColorRenderbuffer[n]=e.createRenderbuffer(),e.bindRenderbuffer(e.RENDERBUFFER,s.__webglColorRenderbuffer[n]);let i=a.convert(r.format,r.colorSpace),o=a.convert(r.type),c=S(r.internalFormat,i,o,r.normalized,r.colorSpace,t.isXRRenderTarget===!0),u=B(t);e.renderbufferStorageMultisample(e.RENDERBUFFER,u,c,t.width,t.height),e.framebufferRenderbuffer(e.FRAMEBUFFER,e.COLOR_ATTACHMENT0+n,e.RENDERBUFFER,s.__webglColorRenderbuffer[n])}e.bindRenderbuffer(e.RENDERBUFFER,null),t.depthBuffer&&(s.__webglDepthRenderbuffer=e.createRenderbuffer(),ge(s.__webglDepthRenderbuffer,t,!0)),n.bindFramebuffer(e.FRAMEBUFFER,null)}}if(u){n.bindTexture(e.TEXTURE_CUBE_MAP,c.__webglTexture),le(e.TEXTURE_CUBE_MAP,i);for(let n=0;n<6;n++)if(i.mipmaps.length>0)for(let r=0;r<i.mipmaps.length;r++)he(s.__webglFramebuffer[n][r],t,i,e.COLOR_ATTACHMENT0,e.TEXTURE_CUBE_MAP_POSITIVE_X+n,r);else he(s.__webglFramebuffer[n],t,i,e.COLOR_ATTACHMENT0,e.TEXTURE_CUBE_MAP_POSITIVE_X+n,0);y(i)?b(e.TEXTURE_CUBE_MAP):i.mipmaps.length>0&&e.texParameteri(e.TEXTURE_CUBE_MAP,e.TEXTURE_MAX_LEVEL,i.mipmaps.length-1),n.unbindTexture()}else if(d){for(let i=0,a=l.length;i<a;i++){let a=l[i],o=r.get(a),c=e.TEXTURE_2D;(t.isWebGL3DRenderTarget||t.isWebGLArrayRenderTarget)&&(c=t.isWebGL3DRenderTarget?e.TEXTURE_3D:e.TEXTURE_2D_ARRAY),n.bindTexture(c,o.__webglTexture),le(c,a),he(s.__webglFramebuffer,t,a,e.COLOR_ATTACHMENT0+i,c,0),y(a)&&b(c)}n.unbindTexture()}else{let r=e.TEXTURE_2D;if((t.isWebGL3DRenderTarget||t.isWebGLArrayRenderTarget)&&(r=t.isWebGL3DRenderTarget?e.TEXTURE_3D:e.TEXTURE_2D_ARRAY),n.bindTexture(r,c.__webglTexture),le(r,i),i.mipmaps.length>0)for(let n=0;n<i.mipmaps.length;n++)he(s.__webglFramebuffer[n],t,i,e.COLOR_ATTACHMENT0,r,n);else he(s.__webglFramebuffer,t,i,e.COLOR_ATTACHMENT0,r,0);y(i)?b(r):i.mipmaps.length>0&&e.texParameteri(r,e.TEXTURE_MAX_LEVEL,i.mipmaps.length-1),n.unbindTexture()}t.depthBuffer&&ve(t)}function be(e){let t=e.textures;for(let i=0,a=t.length;i<a;i++){let a=t[i];if(y(a)&&a.mipmapsAutoUpdate===!0){let t=x(e),i=r.get(a).__webglTexture;n.bindTexture(t,i),b(t),n.unbindTexture()}}}let xe=[];function Se(t){if(t.samples>0){if(Ce(t)===!1){let i=t.textures,a=t.width,o=t.height,s=e.COLOR_BUFFER_BIT,l=t.stencilBuffer?e.DEPTH_STENCIL_ATTACHMENT:e.DEPTH_ATTACHMENT,u=r.get(t),d=i.length>1;if(d)for(let t=0;t<i.length;t++)n.bindFramebuffer(e.FRAMEBUFFER,u.__webglMultisampledFramebuffer),e.framebufferRenderbuffer(e.FRAMEBUFFER,e.COLOR_ATTACHMENT0+t,e.RENDERBUFFER,null),n.bindFramebuffer(e.FRAMEBUFFER,u.__webglFramebuffer),e.framebufferTexture2D(e.DRAW_FRAMEBUFFER,e.COLOR_ATTACHMENT0+t,e.TEXTURE_2D,null,0);n.bindFramebuffer(e.READ_FRAMEBUFFER,u.__webglMultisampledFramebuffer),t.texture.mipmaps.length>0?n.bindFramebuffer(e.DRAW_FRAMEBUFFER,u.__webglFramebuffer[0]):n.bindFramebuffer(e.DRAW_FRAMEBUFFER,u.__webglFramebuffer);for(let n=0;n<i.length;n++){if(t.resolveDepthBuffer&&(t.depthBuffer&&(s|=e.DEPTH_BUFFER_BIT),t.stencilBuffer&&t.resolveStencilBuffer&&(s|=e.STENCIL_BUFFER_BIT)),d){e.framebufferRenderbuffer(e.READ_FRAMEBUFFER,e.COLOR_ATTACHMENT0,e.RENDERBUFFER,u.__webglColorRenderbuffer[n]);let t=r.get(i[n]).__webglTexture;e.framebufferTexture2D(e.DRAW_FRAMEBUFFER,e.COLOR_ATTACHMENT0,e.TEXTURE_2D,t,0)}e.blitFramebuffer(0,0,a,o,0,0,a,o,s,e.NEAREST),c===!0&&(xe.length=0,xe.push(e.COLOR_ATTACHMENT0+n),t.depthBuffer&&t.storeMultisampledDepthBuffer===!1&&xe.push(l),e.invalidateFramebuffer(e.READ_FRAMEBUFFER,xe))}if(n.bindFramebuffer(e.READ_FRAMEBUFFER,null),n.bindFramebuffer(e.DRAW_FRAMEBUFFER,null),d)for(let t=0;t<i.length;t++){n.bindFramebuffer(e.FRAMEBUFFER,u.__webglMultisampledFramebuffer),e.framebufferRenderbuffer(e.FRAMEBUFFER,e.COLOR_ATTACHMENT0+t,e.RENDERBUFFER,u.__webglColorRenderbuffer[t]);let a=r.get(i[t]).__webglTexture;n.bindFramebuffer(e.FRAMEBUFFER,u.__webglFramebuffer),e.framebufferTexture2D(e.DRAW_FRAMEBUFFER,e.COLOR_ATTACHMENT0+t,e.TEXTURE_2D,a,0)}n.bindFramebuffer(e.DRAW_FRAMEBUFFER,u.__webglMultisampledFramebuffer)}else if(t.depthBuffer&&t.storeMultisampledDepthBuffer===!1&&c){let n=t.stencilBuffer?e.DEPTH_STENCIL_ATTACHMENT:e.DEPTH_ATTACHMENT;e.invalidateFramebuffer(e.DRAW_FRAMEBUFFER,[n])}}}function B(e){return Math.min(i.maxSamples,e.samples)}function Ce(e){let n=r.get(e);return e.samples>0&&t.has(`WEBGL_multisampled_render_to_texture`)===!0&&n.__useRenderToTexture!==!1}function V(e){let t=o.render.frame;u.get(e)!==t&&(u.set(e,t),e.update())}function H(e,t){let n=e.colorSpace,r=e.format,i=e.type;return e.isCompressedTexture===!0||e.isVideoTexture===!0||n!==`srgb-linear`&&n!==``&&(Sr.getTransfer(n)===`srgb`?(r!==1023||i!==1009)&&U(`WebGLTextures: sRGB encoded textures have to use RGBAFormat and UnsignedByteType.`):W(`WebGLTextures: Unsupported texture color space:`,n)),t}function we(e){return typeof HTMLImageElement<`u`&&e instanceof HTMLImageElement?(l.width=e.naturalWidth||e.width,l.height=e.naturalHeight||e.height):typeof VideoFrame<`u`&&e instanceof VideoFrame?(l.width=e.displayWidth,l.height=e.displayHeight):(l.width=e.width,l.height=e.height),l}this.allocateTextureUnit=re,this.resetTextureUnits=F,this.getTextureUnits=te,this.setTextureUnits=ne,this.setTexture2D=I,this.setTexture2DArray=ae,this.setTexture3D=oe,this.setTextureCube=L,this.rebindTextures=ye,this.setupRenderTarget=z,this.updateRenderTargetMipmap=be,this.updateMultisampleRenderTarget=Se,this.setupDepthRenderbuffer=ve,this.setupFrameBufferTexture=he,this.useMultisampledRTT=Ce,this.dispose=j}function hf(e,t){function n(n,r=``){let i,a=Sr.getTransfer(r);if(n===1009)return e.UNSIGNED_BYTE;if(n===1017)return e.UNSIGNED_SHORT_4_4_4_4;if(n===1018)return e.UNSIGNED_SHORT_5_5_5_1;if(n===35902)return e.UNSIGNED_INT_5_9_9_9_REV;if(n===35899)return e.UNSIGNED_INT_10F_11F_11F_REV;if(n===1010)return e.BYTE;if(n===1011)return e.SHORT;if(n===1012)return e.UNSIGNED_SHORT;if(n===1013)return e.INT;if(n===1014)return e.UNSIGNED_INT;if(n===1015)return e.FLOAT;if(n===1016)return e.HALF_FLOAT;if(n===1021)return e.ALPHA;if(n===1022)return e.RGB;if(n===1023)return e.RGBA;if(n===1026)return e.DEPTH_COMPONENT;if(n===1027)return e.DEPTH_STENCIL;if(n===1028)return e.RED;if(n===1029)return e.RED_INTEGER;if(n===1030)return e.RG;if(n===1031)return e.RG_INTEGER;if(n===1033)return e.RGBA_INTEGER;if(n===33776||n===33777||n===33778||n===33779){if(a===`srgb`){if(i=t.get(`WEBGL_compressed_texture_s3tc_srgb`),i!==null){if(n===33776)return i.COMPRESSED_SRGB_S3TC_DXT1_EXT;if(n===33777)return i.COMPRESSED_SRGB_ALPHA_S3TC_DXT1_EXT;if(n===33778)return i.COMPRESSED_SRGB_ALPHA_S3TC_DXT3_EXT;if(n===33779)return i.COMPRESSED_SRGB_ALPHA_S3TC_DXT5_EXT}else return null}else if(i=t.get(`WEBGL_compressed_texture_s3tc`),i!==null){if(n===33776)return i.COMPRESSED_RGB_S3TC_DXT1_EXT;if(n===33777)return i.COMPRESSED_RGBA_S3TC_DXT1_EXT;if(n===33778)return i.COMPRESSED_RGBA_S3TC_DXT3_EXT;if(n===33779)return i.COMPRESSED_RGBA_S3TC_DXT5_EXT}else return null}if(n===35840||n===35841||n===35842||n===35843){if(i=t.get(`WEBGL_compressed_texture_pvrtc`),i!==null){if(n===35840)return i.COMPRESSED_RGB_PVRTC_4BPPV1_IMG;if(n===35841)return i.COMPRESSED_RGB_PVRTC_2BPPV1_IMG;if(n===35842)return i.COMPRESSED_RGBA_PVRTC_4BPPV1_IMG;if(n===35843)return i.COMPRESSED_RGBA_PVRTC_2BPPV1_IMG}else return null}if(n===36196||n===37492||n===37496||n===37488||n===37489||n===37490||n===37491){if(i=t.get(`WEBGL_compressed_texture_etc`),i!==null){if(n===36196||n===37492)return a===`srgb`?i.COMPRESSED_SRGB8_ETC2:i.COMPRESSED_RGB8_ETC2;if(n===37496)return a===`srgb`?i.COMPRESSED_SRGB8_ALPHA8_ETC2_EAC:i.COMPRESSED_RGBA8_ETC2_EAC;if(n===37488)return i.COMPRESSED_R11_EAC;if(n===37489)return i.COMPRESSED_SIGNED_R11_EAC;if(n===37490)return i.COMPRESSED_RG11_EAC;if(n===37491)return i.COMPRESSED_SIGNED_RG11_EAC}else return null}if(n===37808||n===37809||n===37810||n===37811||n===37812||n===37813||n===37814||n===37815||n===37816||n===37817||n===37818||n===37819||n===37820||n===37821){if(i=t.get(`WEBGL_compressed_texture_astc`),i!==null){if(n===37808)return a===`srgb`?i.COMPRESSED_SRGB8_ALPHA8_ASTC_4x4_KHR:i.COMPRESSED_RGBA_ASTC_4x4_KHR;if(n===37809)return a===`srgb`?i.COMPRESSED_SRGB8_ALPHA8_ASTC_5x4_KHR:i.COMPRESSED_RGBA_ASTC_5x4_KHR;if(n===37810)return a===`srgb`?i.COMPRESSED_SRGB8_ALPHA8_ASTC_5x5_KHR:i.COMPRESSED_RGBA_ASTC_5x5_KHR;if(n===37811)return a===`srgb`?i.COMPRESSED_SRGB8_ALPHA8_ASTC_6x5_KHR:i.COMPRESSED_RGBA_ASTC_6x5_KHR;if(n===37812)return a===`srgb`?i.COMPRESSED_SRGB8_ALPHA8_ASTC_6x6_KHR:i.COMPRESSED_RGBA_ASTC_6x6_KHR;if(n===37813)return a===`srgb`?i.COMPRESSED_SRGB8_ALPHA8_ASTC_8x5_KHR:i.COMPRESSED_RGBA_ASTC_8x5_KHR;if(n===37814)return a===`srgb`?i.COMPRESSED_SRGB8_ALPHA8_ASTC_8x6_KHR:i.COMPRESSED_RGBA_ASTC_8x6_KHR;if(n===37815)return a===`srgb`?i.COMPRESSED_SRGB8_ALPHA8_ASTC_8x8_KHR:i.COMPRESSED_RGBA_ASTC_8x8_KHR;if(n===37816)return a===`srgb`?i.COMPRESSED_SRGB8_ALPHA8_ASTC_10x5_KHR:i.COMPRESSED_RGBA_ASTC_10x5_KHR;if(n===37817)return a===`srgb`?i.COMPRESSED_SRGB8_ALPHA8_ASTC_10x6_KHR:i.COMPRESSED_RGBA_ASTC_10x6_KHR;if(n===37818)return a===`srgb`?i.COMPRESSED_SRGB8_ALPHA8_ASTC_10x8_KHR:i.COMPRESSED_RGBA_ASTC_10x8_KHR;if(n===37819)return a===`srgb`?i.COMPRESSED_SRGB8_ALPHA8_ASTC_10x10_KHR:i.COMPRESSED_RGBA_ASTC_10x10_KHR;if(n===37820)return a===`srgb`?i.COMPRESSED_SRGB8_ALPHA8_ASTC_12x10_KHR:i.COMPRESSED_RGBA_ASTC_12x10_KHR;if(n===37821)return a===`srgb`?i.COMPRESSED_SRGB8_ALPHA8_ASTC_12x12_KHR:i.COMPRESSED_RGBA_ASTC_12x12_KHR}else return null}if(n===36492||n===36494||n===36495){if(i=t.get(`EXT_texture_compression_bptc`),i!==null){if(n===36492)return a===`srgb`?i.COMPRESSED_SRGB_ALPHA_BPTC_UNORM_EXT:i.COMPRESSED_RGBA_BPTC_UNORM_EXT;if(n===36494)return i.COMPRESSED_RGB_BPTC_SIGNED_FLOAT_EXT;if(n===36495)return i.COMPRESSED_RGB_BPTC_UNSIGNED_FLOAT_EXT}else return null}if(n===36283||n===36284||n===36285||n===36286){if(i=t.get(`EXT_texture_compression_rgtc`),i!==null){if(n===36283)return i.COMPRESSED_RED_RGTC1_EXT;if(n===36284)return i.COMPRESSED_SIGNED_RED_RGTC1_EXT;if(n===36285)return i.COMPRESSED_RED_GREEN_RGTC2_EXT;if(n===36286)return i.COMPRESSED_SIGNED_RED_GREEN_RGTC2_EXT}else return null}return n===1020?e.UNSIGNED_INT_24_8:e[n]===void 0?null:e[n]}return{convert:n}}var gf=`
void main() {

	gl_Position = vec4( position, 1.0 );

}`,_f=`
uniform sampler2DArray depthColor;
uniform float depthWidth;
uniform float depthHeight;

void main() {

	vec2 coord = vec2( gl_FragCoord.x / depthWidth, gl_FragCoord.y / depthHeight );

	if ( coord.x >= 1.0 ) {

		gl_FragDepth = texture( depthColor, vec3( coord.x - 1.0, coord.y, 1 ) ).r;

	} else {

		gl_FragDepth = texture( depthColor, vec3( coord.x, coord.y, 0 ) ).r;

	}

}`,vf=class{constructor(){this.texture=null,this.mesh=null,this.depthNear=0,this.depthFar=0}init(e,t){if(this.texture===null){let n=new No(e.texture);(e.depthNear!==t.depthNear||e.depthFar!==t.depthFar)&&(this.depthNear=e.depthNear,this.depthFar=e.depthFar),this.texture=n}}getMesh(e){if(this.texture!==null&&this.mesh===null){let t=e.cameras[0].viewport,n=new uc({vertexShader:gf,fragmentShader:_f,uniforms:{depthColor:{value:this.texture},depthWidth:{value:t.z},depthHeight:{value:t.w}}});this.mesh=new Ha(new Qs(20,20),n)}return this.mesh}reset(){this.texture=null,this.mesh=null}getDepthTexture(){return this.texture}},yf=class extends Vn{constructor(e,t){super();let n=this,r=null,i=1,a=null,o=`local-floor`,s=1,c=null,l=null,u=null,d=null,f=null,p=null,m=typeof XRWebGLBinding<`u`,h=new vf,g={},_=t.getContextAttributes(),v=null,y=null,b=[],x=[],S=new K,C=null,w=null,T=new Vc;T.viewport=new Nr;let E=new Vc;E.viewport=new Nr;let D=[T,E],O=new Kc,k=null,A=null;this.cameraAutoUpdate=!0,this.enabled=!1,this.isPresenting=!1,this.getController=function(e){let t=b[e];return t===void 0&&(t=new mi,b[e]=t),t.getTargetRaySpace()},this.getControllerGrip=function(e){let t=b[e];return t===void 0&&(t=new mi,b[e]=t),t.getGripSpace()},this.getHand=function(e){let t=b[e];return t===void 0&&(t=new mi,b[e]=t),t.getHandSpace()};function j(e){let t=x.indexOf(e.inputSource);if(t===-1)return;let n=b[t];n!==void 0&&(n.update(e.inputSource,e.frame,c||a),n.dispatchEvent({type:e.type,data:e.inputSource}))}function M(){r.removeEventListener(`select`,j),r.removeEventListener(`selectstart`,j),r.removeEventListener(`selectend`,j),r.removeEventListener(`squeeze`,j),r.removeEventListener(`squeezestart`,j),r.removeEventListener(`squeezeend`,j),r.removeEventListener(`end`,M),r.removeEventListener(`inputsourceschange`,N);for(let e=0;e<b.length;e++){let t=x[e];t!==null&&(x[e]=null,b[e].disconnect(t))}k=null,A=null,h.reset();for(let e in g)delete g[e];if(e.setRenderTarget(v),f=null,d=null,u=null,r=null,y=null,ne.stop(),n.isPresenting=!1,e.setPixelRatio(C),e.setSize(S.width,S.height,!1),w!==null){let e=w.camera;e.fov=w.fov,e.zoom=w.zoom,e.updateProjectionMatrix(),w=null}n.dispatchEvent({type:`sessionend`})}this.setFramebufferScaleFactor=function(e){i=e,n.isPresenting===!0&&U(`WebXRManager: Cannot change framebuffer scale while presenting.`)},this.setReferenceSpaceType=function(e){o=e,n.isPresenting===!0&&U(`WebXRManager: Cannot change reference space type while presenting.`)},this.getReferenceSpace=function(){return c||a},this.setReferenceSpace=function(e){c=e},this.getBaseLayer=function(){return d===null?f:d},this.getBinding=function(){return u===null&&m&&(u=new XRWebGLBinding(r,t)),u},this.getFrame=function(){return p},this.getSession=function(){return r},this.setSession=async function(l){if(r=l,r!==null){if(v=e.getRenderTarget(),r.addEventListener(`select`,j),r.addEventListener(`selectstart`,j),r.addEventListener(`selectend`,j),r.addEventListener(`squeeze`,j),r.addEventListener(`squeezestart`,j),r.addEventListener(`squeezeend`,j),r.addEventListener(`end`,M),r.addEventListener(`inputsourceschange`,N),_.xrCompatible!==!0&&await t.makeXRCompatible(),C=e.getPixelRatio(),e.getSize(S),m&&`createProjectionLayer`in XRWebGLBinding.prototype){let n=null,a=null,o=null;_.depth&&(o=_.stencil?t.DEPTH24_STENCIL8:t.DEPTH_COMPONENT24,n=_.stencil?Et:Tt,a=_.stencil?yt:mt);let s={colorFormat:t.RGBA8,depthFormat:o,scaleFactor:i};u=this.getBinding(),d=u.createProjectionLayer(s),r.updateRenderState({layers:[d]}),e.setPixelRatio(1),e.setSize(d.textureWidth,d.textureHeight,!1),y=new Fr(d.textureWidth,d.textureHeight,{format:wt,type:lt,depthTexture:new jo(d.textureWidth,d.textureHeight,a,void 0,void 0,void 0,void 0,void 0,void 0,n),stencilBuffer:_.stencil,colorSpace:e.outputColorSpace,samples:_.antialias?4:0,resolveDepthBuffer:d.ignoreDepthValues===!1,resolveStencilBuffer:d.ignoreDepthValues===!1,storeMultisampledDepthBuffer:d.ignoreDepthValues===!1,storeMultisampledStencilBuffer:d.ignoreDepthValues===!1})}else{let n={antialias:_.antialias,alpha:!0,depth:_.depth,stencil:_.stencil,framebufferScaleFactor:i};f=new XRWebGLLayer(r,t,n),r.updateRenderState({baseLayer:f}),e.setPixelRatio(1),e.setSize(f.framebufferWidth,f.framebufferHeight,!1),y=new Fr(f.framebufferWidth,f.framebufferHeight,{format:wt,type:lt,colorSpace:e.outputColorSpace,stencilBuffer:_.stencil,resolveDepthBuffer:f.ignoreDepthValues===!1,resolveStencilBuffer:f.ignoreDepthValues===!1,storeMultisampledDepthBuffer:f.ignoreDepthValues===!1,storeMultisampledStencilBuffer:f.ignoreDepthValues===!1})}y.isXRRenderTarget=!0,this.setFoveation(s),c=null,a=await r.requestReferenceSpace(o),ne.setContext(r),ne.start(),n.isPresenting=!0,n.dispatchEvent({type:`sessionstart`})}},this.getEnvironmentBlendMode=function(){if(r!==null)return r.environmentBlendMode},this.getDepthTexture=function(){return h.getDepthTexture()};function N(e){for(let t=0;t<e.removed.length;t++){let n=e.removed[t],r=x.indexOf(n);r>=0&&(x[r]=null,b[r].disconnect(n))}for(let t=0;t<e.added.length;t++){let n=e.added[t],r=x.indexOf(n);if(r===-1){for(let e=0;e<b.length;e++)if(e>=x.length){x.push(n),r=e;break}else if(x[e]===null){x[e]=n,r=e;break}if(r===-1)break}let i=b[r];i&&i.connect(n)}}function P(e,t){t===null?e.matrixWorld.copy(e.matrix):e.matrixWorld.multiplyMatrices(t.matrixWorld,e.matrix),e.matrixWorldInverse.copy(e.matrixWorld).invert()}this.updateCamera=function(e){if(r===null)return;let t=e.near,n=e.far;h.texture!==null&&(h.depthNear>0&&(t=h.depthNear),h.depthFar>0&&(n=h.depthFar)),O.near=E.near=T.near=t,O.far=E.far=T.far=n,(k!==O.near||A!==O.far)&&(r.updateRenderState({depthNear:O.near,depthFar:O.far}),k=O.near,A=O.far),O.layers.mask=e.layers.mask|6,T.layers.mask=O.layers.mask&-5,E.layers.mask=O.layers.mask&-3;let i=e.parent,a=O.cameras;P(O,i);for(let e=0;e<a.length;e++)P(a[e],i);O.projectionMatrix.copy(T.projectionMatrix),O.projectionMatrixInverse.copy(T.projectionMatrixInverse),w===null&&e.isPerspectiveCamera&&(w={camera:e,fov:e.fov,zoom:e.zoom}),ee(e,O,i)};function ee(e,t,n){n===null?e.matrix.copy(t.matrixWorld):(e.matrix.copy(n.matrixWorld),e.matrix.invert(),e.matrix.multiply(t.matrixWorld)),e.matrix.decompose(e.position,e.quaternion,e.scale),e.updateMatrixWorld(!0),e.projectionMatrix.copy(t.projectionMatrix),e.projectionMatrixInverse.copy(t.projectionMatrixInverse),e.isPerspectiveCamera&&(e.fov=Gn*2*Math.atan(1/e.projectionMatrix.elements[5]),e.zoom=1)}this.getCamera=function(){return O},this.getFoveation=function(){if(d!==null||f!==null)return s},this.setFoveation=function(e){s=e,d!==null&&(d.fixedFoveation=e),f!==null&&f.fixedFoveation!==void 0&&(f.fixedFoveation=e)},this.hasDepthSensing=function(){return h.texture!==null},this.getDepthSensingMesh=function(){return h.getMesh(O)},this.getCameraTexture=function(e){return g[e]};let F=null;function te(t,i){if(l=i.getViewerPose(c||a),p=i,l!==null){let t=l.views;f!==null&&(e.setRenderTargetFramebuffer(y,f.framebuffer),e.setRenderTarget(y));let i=!1;t.length!==O.cameras.length&&(O.cameras.length=0,i=!0);for(let n=0;n<t.length;n++){let r=t[n],a=null;if(f!==null)a=f.getViewport(r);else{let t=u.getViewSubImage(d,r);a=t.viewport,n===0&&(e.setRenderTargetTextures(y,t.colorTexture,t.depthStencilTexture),e.setRenderTarget(y))}let o=D[n];o===void 0&&(o=new Vc,o.layers.enable(n),o.viewport=new Nr,D[n]=o),o.matrix.fromArray(r.transform.matrix),o.matrix.decompose(o.position,o.quaternion,o.scale),o.projectionMatrix.fromArray(r.projectionMatrix),o.projectionMatrixInverse.copy(o.projectionMatrix).invert(),o.viewport.set(a.x,a.y,a.width,a.height),n===0&&(O.matrix.copy(o.matrix),O.matrix.decompose(O.position,O.quaternion,O.scale)),i===!0&&O.cameras.push(o)}let a=r.enabledFeatures;if(a&&a.includes(`depth-sensing`)&&r.depthUsage==`gpu-optimized`&&m){u=n.getBinding();let e=u.getDepthInformation(t[0]);e&&e.isValid&&e.texture&&h.init(e,r.renderState)}if(a&&a.includes(`camera-access`)&&m){e.state.unbindTexture(),u=n.getBinding();for(let e=0;e<t.length;e++){let n=t[e].camera;if(n){let e=g[n];e||(e=new No,g[n]=e);let t=u.getCameraImage(n);e.sourceTexture=t}}}}for(let e=0;e<b.length;e++){let t=x[e],n=b[e];t!==null&&n!==void 0&&n.update(t,i,c||a)}F&&F(t,i),i.detectedPlanes&&n.dispatchEvent({type:`planesdetected`,data:i}),p=null}let ne=new _l;ne.setAnimationLoop(te),this.setAnimationLoop=function(e){F=e},this.dispose=function(){}}},bf=new Rr,xf=new J;xf.set(-1,0,0,0,1,0,0,0,1);function Sf(e,t){function n(e,t){e.matrixAutoUpdate===!0&&e.updateMatrix(),t.value.copy(e.matrix)}function r(t,n){n.color.getRGB(t.fogColor.value,oc(e)),n.isFog?(t.fogNear.value=n.near,t.fogFar.value=n.far):n.isFogExp2&&(t.fogDensity.value=n.density)}function i(e,t,n,r,i){t.isNodeMaterial?t.uniformsNeedUpdate=!1:t.isMeshBasicMaterial?a(e,t):t.isMeshLambertMaterial?(a(e,t),t.envMap&&(e.envMapIntensity.value=t.envMapIntensity)):t.isMeshToonMaterial?(a(e,t),d(e,t)):t.isMeshPhongMaterial?(a(e,t),u(e,t),t.envMap&&(e.envMapIntensity.value=t.envMapIntensity)):t.isMeshStandardMaterial?(a(e,t),f(e,t),t.isMeshPhysicalMaterial&&p(e,t,i)):t.isMeshMatcapMaterial?(a(e,t),m(e,t)):t.isMeshDepthMaterial?a(e,t):t.isMeshDistanceMaterial?(a(e,t),h(e,t)):t.isMeshNormalMaterial?a(e,t):t.isLineBasicMaterial?(o(e,t),t.isLineDashedMaterial&&s(e,t)):t.isPointsMaterial?c(e,t,n,r):t.isSpriteMaterial?l(e,t):t.isShadowMaterial?(e.color.value.copy(t.color),e.opacity.value=t.opacity):t.isShaderMaterial&&(t.uniformsNeedUpdate=!1)}function a(e,r){e.opacity.value=r.opacity,r.color&&e.diffuse.value.copy(r.color),r.emissive&&e.emissive.value.copy(r.emissive).multiplyScalar(r.emissiveIntensity),r.map&&(e.map.value=r.map,n(r.map,e.mapTransform)),r.alphaMap&&(e.alphaMap.value=r.alphaMap,n(r.alphaMap,e.alphaMapTransform)),r.bumpMap&&(e.bumpMap.value=r.bumpMap,n(r.bumpMap,e.bumpMapTransform),e.bumpScale.value=r.bumpScale,r.side===1&&(e.bumpScale.value*=-1)),r.normalMap&&(e.normalMap.value=r.normalMap,n(r.normalMap,e.normalMapTransform),e.normalScale.value.copy(r.normalScale),r.side===1&&e.normalScale.value.negate()),r.displacementMap&&(e.displacementMap.value=r.displacementMap,n(r.displacementMap,e.displacementMapTransform),e.displacementScale.value=r.displacementScale,e.displacementBias.value=r.displacementBias),r.emissiveMap&&(e.emissiveMap.value=r.emissiveMap,n(r.emissiveMap,e.emissiveMapTransform)),r.specularMap&&(e.specularMap.value=r.specularMap,n(r.specularMap,e.specularMapTransform)),r.alphaTest>0&&(e.alphaTest.value=r.alphaTest);let i=t.get(r),a=i.envMap,o=i.envMapRotation;a&&(e.envMap.value=a,e.envMapRotation.value.setFromMatrix4(bf.makeRotationFromEuler(o)).transpose(),a.isCubeTexture&&a.isRenderTargetTexture===!1&&e.envMapRotation.value.premultiply(xf),e.reflectivity.value=r.reflectivity,e.ior.value=r.ior,e.refractionRatio.value=r.refractionRatio),r.lightMap&&(e.lightMap.value=r.lightMap,e.lightMapIntensity.value=r.lightMapIntensity,n(r.lightMap,e.lightMapTransform)),r.aoMap&&(e.aoMap.value=r.aoMap,e.aoMapIntensity.value=r.aoMapIntensity,n(r.aoMap,e.aoMapTransform))}function o(e,t){e.diffuse.value.copy(t.color),e.opacity.value=t.opacity,t.map&&(e.map.value=t.map,n(t.map,e.mapTransform))}function s(e,t){e.dashSize.value=t.dashSize,e.totalSize.value=t.dashSize+t.gapSize,e.scale.value=t.scale}function c(e,t,r,i){e.diffuse.value.copy(t.color),e.opacity.value=t.opacity,e.size.value=t.size*r,e.scale.value=i*.5,t.map&&(e.map.value=t.map,n(t.map,e.uvTransform)),t.alphaMap&&(e.alphaMap.value=t.alphaMap,n(t.alphaMap,e.alphaMapTransform)),t.alphaTest>0&&(e.alphaTest.value=t.alphaTest)}function l(e,t){e.diffuse.value.copy(t.color),e.opacity.value=t.opacity,e.rotation.value=t.rotation,t.map&&(e.map.value=t.map,n(t.map,e.mapTransform)),t.alphaMap&&(e.alphaMap.value=t.alphaMap,n(t.alphaMap,e.alphaMapTransform)),t.alphaTest>0&&(e.alphaTest.value=t.alphaTest)}function u(e,t){e.specular.value.copy(t.specular),e.shininess.value=Math.max(t.shininess,1e-4)}function d(e,t){t.gradientMap&&(e.gradientMap.value=t.gradientMap)}function f(e,t){e.metalness.value=t.metalness,t.metalnessMap&&(e.metalnessMap.value=t.metalnessMap,n(t.metalnessMap,e.metalnessMapTransform)),e.roughness.value=t.roughness,t.roughnessMap&&(e.roughnessMap.value=t.roughnessMap,n(t.roughnessMap,e.roughnessMapTransform)),t.envMap&&(e.envMapIntensity.value=t.envMapIntensity)}function p(e,t,r){e.ior.value=t.ior,t.diffuseRoughness>0&&(e.diffuseRoughness.value=t.diffuseRoughness,t.diffuseRoughnessMap&&(e.diffuseRoughnessMap.value=t.diffuseRoughnessMap,n(t.diffuseRoughnessMap,e.diffuseRoughnessMapTransform))),t.sheen>0&&(e.sheenColor.value.copy(t.sheenColor).multiplyScalar(t.sheen),e.sheenRoughness.value=t.sheenRoughness,t.sheenColorMap&&(e.sheenColorMap.value=t.sheenColorMap,n(t.sheenColorMap,e.sheenColorMapTransform)),t.sheenRoughnessMap&&(e.sheenRoughnessMap.value=t.sheenRoughnessMap,n(t.sheenRoughnessMap,e.sheenRoughnessMapTransform))),t.clearcoat>0&&(e.clearcoat.value=t.clearcoat,e.clearcoatRoughness.value=t.clearcoatRoughness,t.clearcoatMap&&(e.clearcoatMap.value=t.clearcoatMap,n(t.clearcoatMap,e.clearcoatMapTransform)),t.clearcoatRoughnessMap&&(e.clearcoatRoughnessMap.value=t.clearcoatRoughnessMap,n(t.clearcoatRoughnessMap,e.clearcoatRoughnessMapTransform)),t.clearcoatNormalMap&&(e.clearcoatNormalMap.value=t.clearcoatNormalMap,n(t.clearcoatNormalMap,e.clearcoatNormalMapTransform),e.clearcoatNormalScale.value.copy(t.clearcoatNormalScale),t.side===1&&e.clearcoatNormalScale.value.negate())),t.dispersion>0&&(e.dispersion.value=t.dispersion),t.retroreflectivity>0&&(e.retroreflectivity.value=t.retroreflectivity),t.iridescence>0&&(e.iridescence.value=t.iridescence,e.iridescenceIOR.value=t.iridescenceIOR,e.iridescenceThicknessMinimum.value=t.iridescenceThicknessMinimum,e.iridescenceThicknessMaximum.value=t.iridescenceThicknessMaximum,t.iridescenceMap&&(e.iridescenceMap.value=t.iridescenceMap,n(t.iridescenceMap,e.iridescenceMapTransform)),t.iridescenceThicknessMap&&(e.iridescenceThicknessMap.value=t.iridescenceThicknessMap,n(t.iridescenceThicknessMap,e.iridescenceThicknessMapTransform))),t.transmission>0&&(e.transmission.value=t.transmission,e.transmissionSamplerMap.value=r.texture,e.transmissionSamplerSize.value.set(r.width,r.height),t.transmissionMap&&(e.transmissionMap.value=t.transmissionMap,n(t.transmissionMap,e.transmissionMapTransform)),e.thickness.value=t.thickness,t.thicknessMap&&(e.thicknessMap.value=t.thicknessMap,n(t.thicknessMap,e.thicknessMapTransform)),e.attenuationDistance.value=t.attenuationDistance,e.attenuationColor.value.copy(t.attenuationColor)),t.anisotropy>0&&(e.anisotropyVector.value.set(t.anisotropy*Math.cos(t.anisotropyRotation),t.anisotropy*Math.sin(t.anisotropyRotation)),t.anisotropyMap&&(e.anisotropyMap.value=t.anisotropyMap,n(t.anisotropyMap,e.anisotropyMapTransform))),e.specularIntensity.value=t.specularIntensity,e.specularColor.value.copy(t.specularColor),t.specularColorMap&&(e.specularColorMap.value=t.specularColorMap,n(t.specularColorMap,e.specularColorMapTransform)),t.specularIntensityMap&&(e.specularIntensityMap.value=t.specularIntensityMap,n(t.specularIntensityMap,e.specularIntensityMapTransform))}function m(e,t){t.matcap&&(e.matcap.value=t.matcap)}function h(e,n){let r=t.get(n).light;e.referencePosition.value.setFromMatrixPosition(r.matrixWorld),e.nearDistance.value=r.shadow.camera.near,e.farDistance.value=r.shadow.camera.far}return{refreshFogUniforms:r,refreshMaterialUniforms:i}}function Cf(e,t,n,r){let i={},a={};function o(e,t){let n=t.program;r.uniformBlockBinding(e,n,i[e.id])}function s(e,n){let o=i[e.id];o===void 0&&(m(e),o=c(e),i[e.id]=o,e.addEventListener(`dispose`,g));let s=n.program;r.updateUBOMapping(e,s);let u=t.render.frame;a[e.id]!==u&&(l(e),a[e.id]=u)}function c(t){let n=e.createBuffer(),r=t.__size,i=t.usage;return e.bindBuffer(e.UNIFORM_BUFFER,n),e.bufferData(e.UNIFORM_BUFFER,r,i),e.bindBuffer(e.UNIFORM_BUFFER,null),n}function l(t){let n=i[t.id],r=t.uniforms,a=t.__cache;e.bindBuffer(e.UNIFORM_BUFFER,n);for(let e=0,t=r.length;e<t;e++){let t=r[e];if(Array.isArray(t))for(let n=0,r=t.length;n<r;n++)u(t[n],e,n,a);else u(t,e,0,a)}e.bindBuffer(e.UNIFORM_BUFFER,null)}function u(t,n,r,i){if(f(t,n,r,i)===!0){let n=t.__offset,r=t.value;if(Array.isArray(r)){let e=0;for(let n=0;n<r.length;n++){let i=r[n],a=h(i,!0);d(i,t.__data,e),e+=a.storage/Float32Array.BYTES_PER_ELEMENT}}else d(r,t.__data,0);e.bufferSubData(e.UNIFORM_BUFFER,n,t.__data)}}function d(e,t,n){typeof e==`number`||typeof e==`boolean`?t[n]=e:e.isMatrix3?(t[n]=e.elements[0],t[n+1]=e.elements[1],t[n+2]=e.elements[2],t[n+3]=0,t[n+4]=e.elements[3],t[n+5]=e.elements[4],t[n+6]=e.elements[5],t[n+7]=0,t[n+8]=e.elements[6],t[n+9]=e.elements[7],t[n+10]=e.elements[8],t[n+11]=0):ArrayBuffer.isView(e)?t.set(e.subarray(0,t.length-n),n):e.toArray(t,n)}function f(e,t,n,r){let i=e.value,a=t+`_`+n;if(Array.isArray(i)){r[a]===void 0&&(r[a]=[]);let e=r[a],t=!1;for(let n=0;n<i.length;n++)p(i[n],e,n)===!0&&(t=!0);return t}return p(i,r,a)}function p(e,t,n){if(t[n]===void 0)return t[n]=typeof e==`number`||typeof e==`boolean`?e:ArrayBuffer.isView(e)?e.slice():e.clone(),!0;{let r=t[n];if(typeof e==`number`||typeof e==`boolean`){if(r!==e)return t[n]=e,!0}else if(ArrayBuffer.isView(e))return!0;else if(r.equals(e)===!1)return r.copy(e),!0}return!1}function m(e){let t=e.uniforms,n=0;for(let e=0,r=t.length;e<r;e++){let r=Array.isArray(t[e])?t[e]:[t[e]];for(let i=0,a=r.length;i<a;i++){let a=r[i],o=Array.isArray(a.value)?a.value:[a.value],s=Array.isArray(t[e])||Array.isArray(a.value),c=n;for(let e=0,t=o.length;e<t;e++){let t=o[e],r=h(t,s),i=n%16,a=i%r.boundary,l=i+a;n+=a,l!==0&&16-l<r.storage&&(n+=16-l),e===0&&(c=n),n+=r.storage}a.__data=new(a.type===`int`?Int32Array:a.type===`uint`?Uint32Array:Float32Array)((n-c)/Float32Array.BYTES_PER_ELEMENT),a.__offset=c}}let r=n%16;return r>0&&(n+=16-r),e.__size=n,e.__cache={},this}function h(e,t){let n={boundary:0,storage:0};return typeof e==`number`||typeof e==`boolean`?(n.boundary=4,n.storage=4):e.isVector2?(n.boundary=8,n.storage=8):e.isVector3||e.isColor?(n.boundary=16,n.storage=12):e.isVector4?(n.boundary=16,n.storage=16):e.isMatrix3?(n.boundary=16,n.storage=48):e.isMatrix4?(n.boundary=16,n.storage=64):e.isTexture?U(`WebGLRenderer: Texture samplers can not be part of an uniforms group.`):ArrayBuffer.isView(e)?(n.boundary=16,n.storage=e.byteLength):U(`WebGLRenderer: Unsupported uniform value type.`,e),t===!0&&(n.boundary=16,n.storage=Math.ceil(n.storage/16)*16),n}function g(t){let n=t.target;n.removeEventListener(`dispose`,g),e.deleteBuffer(i[n.id]),delete i[n.id],delete a[n.id]}function _(){for(let t in i)e.deleteBuffer(i[t]);i={},a={}}return{bind:o,update:s,dispose:_}}var wf=new Uint16Array([12469,15057,12620,14925,13266,14620,13807,14376,14323,13990,14545,13625,14713,13328,14840,12882,14931,12528,14996,12233,15039,11829,15066,11525,15080,11295,15085,10976,15082,10705,15073,10495,13880,14564,13898,14542,13977,14430,14158,14124,14393,13732,14556,13410,14702,12996,14814,12596,14891,12291,14937,11834,14957,11489,14958,11194,14943,10803,14921,10506,14893,10278,14858,9960,14484,14039,14487,14025,14499,13941,14524,13740,14574,13468,14654,13106,14743,12678,14818,12344,14867,11893,14889,11509,14893,11180,14881,10751,14852,10428,14812,10128,14765,9754,14712,9466,14764,13480,14764,13475,14766,13440,14766,13347,14769,13070,14786,12713,14816,12387,14844,11957,14860,11549,14868,11215,14855,10751,14825,10403,14782,10044,14729,9651,14666,9352,14599,9029,14967,12835,14966,12831,14963,12804,14954,12723,14936,12564,14917,12347,14900,11958,14886,11569,14878,11247,14859,10765,14828,10401,14784,10011,14727,9600,14660,9289,14586,8893,14508,8533,15111,12234,15110,12234,15104,12216,15092,12156,15067,12010,15028,11776,14981,11500,14942,11205,14902,10752,14861,10393,14812,9991,14752,9570,14682,9252,14603,8808,14519,8445,14431,8145,15209,11449,15208,11451,15202,11451,15190,11438,15163,11384,15117,11274,15055,10979,14994,10648,14932,10343,14871,9936,14803,9532,14729,9218,14645,8742,14556,8381,14461,8020,14365,7603,15273,10603,15272,10607,15267,10619,15256,10631,15231,10614,15182,10535,15118,10389,15042,10167,14963,9787,14883,9447,14800,9115,14710,8665,14615,8318,14514,7911,14411,7507,14279,7198,15314,9675,15313,9683,15309,9712,15298,9759,15277,9797,15229,9773,15166,9668,15084,9487,14995,9274,14898,8910,14800,8539,14697,8234,14590,7790,14479,7409,14367,7067,14178,6621,15337,8619,15337,8631,15333,8677,15325,8769,15305,8871,15264,8940,15202,8909,15119,8775,15022,8565,14916,8328,14804,8009,14688,7614,14569,7287,14448,6888,14321,6483,14088,6171,15350,7402,15350,7419,15347,7480,15340,7613,15322,7804,15287,7973,15229,8057,15148,8012,15046,7846,14933,7611,14810,7357,14682,7069,14552,6656,14421,6316,14251,5948,14007,5528,15356,5942,15356,5977,15353,6119,15348,6294,15332,6551,15302,6824,15249,7044,15171,7122,15070,7050,14949,6861,14818,6611,14679,6349,14538,6067,14398,5651,14189,5311,13935,4958,15359,4123,15359,4153,15356,4296,15353,4646,15338,5160,15311,5508,15263,5829,15188,6042,15088,6094,14966,6001,14826,5796,14678,5543,14527,5287,14377,4985,14133,4586,13869,4257,15360,1563,15360,1642,15358,2076,15354,2636,15341,3350,15317,4019,15273,4429,15203,4732,15105,4911,14981,4932,14836,4818,14679,4621,14517,4386,14359,4156,14083,3795,13808,3437,15360,122,15360,137,15358,285,15355,636,15344,1274,15322,2177,15281,2765,15215,3223,15120,3451,14995,3569,14846,3567,14681,3466,14511,3305,14344,3121,14037,2800,13753,2467,15360,0,15360,1,15359,21,15355,89,15346,253,15325,479,15287,796,15225,1148,15133,1492,15008,1749,14856,1882,14685,1886,14506,1783,14324,1608,13996,1398,13702,1183]),Tf=null;function Ef(){return Tf===null&&(Tf=new Ga(wf,16,16,kt,gt),Tf.name=`DFG_LUT`,Tf.minFilter=ot,Tf.magFilter=ot,Tf.wrapS=tt,Tf.wrapT=tt,Tf.generateMipmaps=!1,Tf.needsUpdate=!0),Tf}var Df=class{constructor(e={}){let{canvas:t=Pn(),context:n=null,depth:r=!0,stencil:i=!1,alpha:a=!1,antialias:o=!1,premultipliedAlpha:s=!0,preserveDrawingBuffer:c=!1,powerPreference:l=`default`,failIfMajorPerformanceCaveat:u=!1,reversedDepthBuffer:d=!1,outputBufferType:f=lt}=e;this.isWebGLRenderer=!0;let p;if(n!==null){if(typeof WebGLRenderingContext<`u`&&n instanceof WebGLRenderingContext)throw Error(`THREE.WebGLRenderer: WebGL 1 is not supported since r163.`);p=n.getContextAttributes().alpha}else p=a;let m=f,h=new Set([jt,At,Ot]),g=new Set([lt,mt,ft,yt,_t,vt]),_=new Uint32Array(4),v=new Int32Array(4),y={textures:[],min:[],max:[],resolution:[]},b=null,x=null,S=[],C=[],w=null;this.domElement=t,this.debug={checkShaderErrors:!0,diagnostics:{keywords:!1},onShaderError:null},this.autoClear=!0,this.autoClearColor=!0,this.autoClearDepth=!0,this.autoClearStencil=!0,this.sortObjects=!0,this.clippingPlanes=[],this.localClippingEnabled=!1,this.toneMapping=0,this.toneMappingExposure=1,this.transmissionResolutionScale=1;let T=this,E=!1,D=null,O=null,k=null,A=null;this._outputColorSpace=Cn;let j=0,M=0,N=null,P=-1,ee=null,F=new Nr,te=new Nr,ne=null,re=new Y(0),ie=0,I=t.width,ae=t.height,oe=1,L=null,R=null,se=new Nr(0,0,I,ae),ce=new Nr(0,0,I,ae),le=!1,ue=new io,de=new oo,fe=!1,pe=!1,me=new Rr,he=new q,ge=new Nr,_e={background:null,fog:null,environment:null,overrideMaterial:null,isScene:!0},ve=!1;function ye(){return N===null?oe:1}let z=n;function be(e,n){return t.getContext(e,n)}let xe,Se,B,Ce,V,H,we,Te,Ee,De,Oe,ke,Ae,je,Me,Ne,Pe,Fe,Ie,Le,Re,ze,Be;try{let e={alpha:!0,depth:r,stencil:i,antialias:o,premultipliedAlpha:s,preserveDrawingBuffer:c,powerPreference:l,failIfMajorPerformanceCaveat:u};if(`setAttribute`in t&&t.setAttribute(`data-engine`,`three.js r187`),t.addEventListener(`webglcontextlost`,Ue,!1),t.addEventListener(`webglcontextrestored`,We,!1),t.addEventListener(`webglcontextcreationerror`,Ge,!1),z===null){let t=`webgl2`;if(z=be(t,e),z===null)throw be(t)?Error(`THREE.WebGLRenderer: Error creating WebGL context with your selected attributes.`):Error(`THREE.WebGLRenderer: Error creating WebGL context.`)}Ve()}catch(e){throw t.removeEventListener(`webglcontextlost`,Ue,!1),t.removeEventListener(`webglcontextrestored`,We,!1),t.removeEventListener(`webglcontextcreationerror`,Ge,!1),W(`WebGLRenderer: `+e.message),e}function Ve(){xe=new Kl(z),xe.init(),Re=new hf(z,xe),Se=new El(z,xe,e,Re),B=new pf(z,xe),Se.reversedDepthBuffer&&d&&B.buffers.depth.setReversed(!0),O=z.createFramebuffer(),k=z.createFramebuffer(),A=z.createFramebuffer(),Ce=new Yl(z),V=new Kd,H=new mf(z,xe,B,V,Se,Re,Ce),we=new Gl(T),Te=new vl(z),ze=new wl(z,Te),Ee=new ql(z,Te,Ce,ze),De=new Zl(z,Ee,Te,ze,Ce),Fe=new Xl(z,Se,H),Me=new Dl(V),Oe=new Gd(T,we,xe,Se,ze,Me),ke=new Sf(T,V),Ae=new Xd,je=new rf(xe),Pe=new Cl(T,we,B,De,p,s),Ne=new ff(T,De,Se),Be=new Cf(z,Ce,Se,B),Ie=new Tl(z,xe,Ce),Le=new Jl(z,xe,Ce),Ce.programs=Oe.programs,T.capabilities=Se,T.extensions=xe,T.properties=V,T.renderLists=Ae,T.shadowMap=Ne,T.state=B,T.info=Ce}m!==1009&&(w=new $l(m,t.width,t.height,o,r,i));let He=new yf(T,z);this.xr=He,this.getContext=function(){return z},this.getContextAttributes=function(){return z.getContextAttributes()},this.forceContextLoss=function(){let e=xe.get(`WEBGL_lose_context`);e&&e.loseContext()},this.forceContextRestore=function(){let e=xe.get(`WEBGL_lose_context`);e&&e.restoreContext()},this.getPixelRatio=function(){return oe},this.setPixelRatio=function(e){e!==void 0&&(oe=e,this.setSize(I,ae,!1))},this.getSize=function(e){return e.set(I,ae)},this.setSize=function(e,n,r=!0){He.isPresenting?U(`WebGLRenderer: Can't change size while VR device is presenting.`):(I=e,ae=n,t.width=Math.floor(e*oe),t.height=Math.floor(n*oe),r===!0&&(t.style.width=e+`px`,t.style.height=n+`px`),w!==null&&w.setSize(t.width,t.height),this.setViewport(0,0,e,n))},this.getDrawingBufferSize=function(e){return e.set(I*oe,ae*oe).floor()},this.setDrawingBufferSize=function(e,n,r){I=e,ae=n,oe=r,t.width=Math.floor(e*r),t.height=Math.floor(n*r),this.setViewport(0,0,e,n)},this.setEffects=function(e){if(m===1009)W(`WebGLRenderer: setEffects() requires outputBufferType set to HalfFloatType or FloatType.`);else{if(e){for(let t=0;t<e.length;t++)if(e[t].isOutputPass===!0){U(`WebGLRenderer: OutputPass is not needed in setEffects(). Tone mapping and color space conversion are applied automatically.`);break}}w.setEffects(e||[])}},this.getCurrentViewport=function(e){return e.copy(F)},this.getViewport=function(e){return e.copy(se)},this.setViewport=function(e,t,n,r){e.isVector4?se.set(e.x,e.y,e.z,e.w):se.set(e,t,n,r),B.viewport(F.copy(se).multiplyScalar(ye()).round())},this.getScissor=function(e){return e.copy(ce)},this.setScissor=function(e,t,n,r){e.isVector4?ce.set(e.x,e.y,e.z,e.w):ce.set(e,t,n,r),B.scissor(te.copy(ce).multiplyScalar(ye()).round())},this.getScissorTest=function(){return le},this.setScissorTest=function(e){B.setScissorTest(le=e)},this.setOpaqueSort=function(e){L=e},this.setTransparentSort=function(e){R=e},this.getClearColor=function(e){return e.copy(Pe.getClearColor())},this.setClearColor=function(){Pe.setClearColor(...arguments)},this.getClearAlpha=function(){return Pe.getClearAlpha()},this.setClearAlpha=function(){Pe.setClearAlpha(...arguments)},this.clear=function(e=!0,t=!0,n=!0){let r=0;if(e){let e=!1;if(N!==null){let t=N.texture.format;e=h.has(t)}if(e){let e=N.texture.type,t=g.has(e),n=Pe.getClearColor(),r=Pe.getClearAlpha(),i=n.r,a=n.g,o=n.b;t?(_[0]=i,_[1]=a,_[2]=o,_[3]=r,z.clearBufferuiv(z.COLOR,0,_)):(v[0]=i,v[1]=a,v[2]=o,v[3]=r,z.clearBufferiv(z.COLOR,0,v))}else r|=z.COLOR_BUFFER_BIT}t&&(r|=z.DEPTH_BUFFER_BIT,this.state.buffers.depth.setMask(!0)),n&&(r|=z.STENCIL_BUFFER_BIT,this.state.buffers.stencil.setMask(4294967295)),r!==0&&z.clear(r)},this.clearColor=function(){this.clear(!0,!1,!1)},this.clearDepth=function(){this.clear(!1,!0,!1)},this.clearStencil=function(){this.clear(!1,!1,!0)},this.setNodesHandler=function(e){e.setRenderer(this),D=e},this.dispose=function(){t.removeEventListener(`webglcontextlost`,Ue,!1),t.removeEventListener(`webglcontextrestored`,We,!1),t.removeEventListener(`webglcontextcreationerror`,Ge,!1),Pe.dispose(),Ae.dispose(),je.dispose(),H.dispose(),V.dispose(),we.dispose(),De.dispose(),Ee.dispose(),ze.dispose(),Be.dispose(),Oe.dispose(),He.dispose(),He.removeEventListener(`sessionstart`,Qe),He.removeEventListener(`sessionend`,$e),et.stop()};function Ue(e){e.preventDefault(),In(`WebGLRenderer: Context Lost.`),E=!0}function We(){In(`WebGLRenderer: Context Restored.`),E=!1;let e=Ce.autoReset,t=Ne.enabled,n=Ne.autoUpdate,r=Ne.needsUpdate,i=Ne.type;Ve(),Ce.autoReset=e,Ne.enabled=t,Ne.autoUpdate=n,Ne.needsUpdate=r,Ne.type=i}function Ge(e){W(`WebGLRenderer: A WebGL context could not be created. Reason: `,e.statusMessage)}function Ke(e){let t=e.target;t.removeEventListener(`dispose`,Ke),qe(t)}function qe(e){Je(e),V.remove(e)}function Je(e){let t=V.get(e).programs;t!==void 0&&(t.forEach(function(e){Oe.releaseProgram(e)}),e.isShaderMaterial&&Oe.releaseShaderCache(e))}this.renderBufferDirect=function(e,t,n,r,i,a){t===null&&(t=_e);let o=i.isMesh&&i.matrixWorld.determinantAffine()<0,s=ht(e,t,n,r,i);B.setMaterial(r,o);let c=n.index,l=1;if(r.wireframe===!0){if(c=Ee.getWireframeAttribute(n),c===void 0)return;l=2}let u=n.drawRange,d=n.attributes.position,f=u.start*l,p=(u.start+u.count)*l;a!==null&&(f=Math.max(f,a.start*l),p=Math.min(p,(a.start+a.count)*l)),c===null?d!=null&&(f=Math.max(f,0),p=Math.min(p,d.count)):(f=Math.max(f,0),p=Math.min(p,c.count));let m=p-f;if(m<0||m===1/0)return;ze.setup(i,r,s,n,c);let h,g=Ie;if(c!==null&&(h=Te.get(c),g=Le,g.setIndex(h)),i.isMesh)r.wireframe===!0?(B.setLineWidth(r.wireframeLinewidth*ye()),g.setMode(z.LINES)):g.setMode(z.TRIANGLES);else if(i.isLine){let e=r.linewidth;e===void 0&&(e=1),B.setLineWidth(e*ye()),i.isLineSegments?g.setMode(z.LINES):i.isLineLoop?g.setMode(z.LINE_LOOP):g.setMode(z.LINE_STRIP)}else i.isPoints?g.setMode(z.POINTS):i.isSprite&&g.setMode(z.TRIANGLES);if(i.isBatchedMesh){if(xe.get(`WEBGL_multi_draw`))g.renderMultiDraw(i._multiDrawStarts,i._multiDrawCounts,i._multiDrawCount);else{let e=i._multiDrawStarts,t=i._multiDrawCounts,n=i._multiDrawCount,a=c?Te.get(c).bytesPerElement:1,o=V.get(r).currentProgram.getUniforms();for(let r=0;r<n;r++)o.setValue(z,`_gl_DrawID`,r),g.render(e[r]/a,t[r])}}else if(i.isInstancedMesh)g.renderInstances(f,m,i.count);else if(n.isInstancedBufferGeometry){let e=n._maxInstanceCount===void 0?1/0:n._maxInstanceCount,t=Math.min(n.instanceCount,e);g.renderInstances(f,m,t)}else g.render(f,m)};function Ye(e,t,n,r){D!==null&&e.isNodeMaterial&&D.setObject(r,e),fe===!0&&Me.setState(e,n,!1),e.transparent===!0&&e.side===2&&e.forceSinglePass===!1?(e.side=1,e.needsUpdate=!0,st(e,t,r),e.side=0,e.needsUpdate=!0,st(e,t,r),e.side=2):st(e,t,r)}this.compile=function(e,t,n=null){n===null&&(n=e),D!==null&&D.renderStart(e,t,n),x=je.get(n),x.init(t),C.push(x),n.traverseVisible(function(e){e.isLight&&e.layers.test(t.layers)&&(x.pushLight(e),e.castShadow&&x.pushShadow(e))}),e!==n&&e.traverseVisible(function(e){e.isLight&&e.layers.test(t.layers)&&(x.pushLight(e),e.castShadow&&x.pushShadow(e))}),x.setupLights(),D!==null&&D.updateLights(x.state.lightsArray),pe=this.localClippingEnabled,fe=Me.init(this.clippingPlanes,pe),fe===!0&&Me.setGlobalState(this.clippingPlanes,t),D!==null&&Ne.render(x.state.shadowsArray,n,t);let r=new Set;return e.traverse(function(e){if(!(e.isMesh||e.isPoints||e.isLine||e.isSprite))return;let i=e.material;if(i){if(Array.isArray(i))for(let a=0;a<i.length;a++){let o=i[a];Ye(o,n,t,e),r.add(o)}else Ye(i,n,t,e),r.add(i)}}),x=C.pop(),D!==null&&D.renderEnd(),r},this.compileAsync=function(e,t,n=null){let r=this.compile(e,t,n);return new Promise(t=>{function n(){r.forEach(function(e){let t=V.get(e).currentProgram;(t===void 0||t.isReady())&&r.delete(e)}),r.size===0?t(e):setTimeout(n,10)}xe.get(`KHR_parallel_shader_compile`)===null?setTimeout(n,10):n()})};let Xe=null;function Ze(e){Xe&&Xe(e)}function Qe(){et.stop()}function $e(){et.start()}let et=new _l;et.setAnimationLoop(Ze),typeof self<`u`&&et.setContext(self),this.setAnimationLoop=function(e){Xe=e,He.setAnimationLoop(e),e===null?et.stop():et.start()},He.addEventListener(`sessionstart`,Qe),He.addEventListener(`sessionend`,$e),this.render=function(e,t){if(t!==void 0&&t.isCamera!==!0){W(`WebGLRenderer.render: camera is not an instance of THREE.Camera.`);return}if(E===!0)return;D!==null&&D.renderStart(e,t);let n=He.enabled===!0&&He.isPresenting===!0,r=w!==null&&(N===null||n)&&w.begin(T,N);if(e.matrixWorldAutoUpdate===!0&&e.updateMatrixWorld(),t.parent===null&&t.matrixWorldAutoUpdate===!0&&t.updateMatrixWorld(),He.enabled===!0&&He.isPresenting===!0&&(w===null||w.isCompositing()===!1)&&(He.cameraAutoUpdate===!0&&He.updateCamera(t),t=He.getCamera()),e.isScene===!0&&e.onBeforeRender(T,e,t,N),x=je.get(e,C.length),x.init(t),x.state.textureUnits=H.getTextureUnits(),C.push(x),me.multiplyMatrices(t.projectionMatrix,t.matrixWorldInverse),t.isArrayCamera?de.setFromArrayCamera(t):ue.setFromProjectionMatrix(me,An,t.reversedDepth),pe=this.localClippingEnabled,fe=Me.init(this.clippingPlanes,pe),b=Ae.get(e,S.length),b.init(),S.push(b),this.info.render.frame++,He.enabled===!0&&He.isPresenting===!0){let e=T.xr.getDepthSensingMesh();e!==null&&tt(e,t,-1/0,T.sortObjects)}tt(e,t,0,T.sortObjects),b.finish(),D!==null&&D.updateLights(x.state.lightsArray),T.sortObjects===!0&&b.sort(L,R),ve=He.enabled===!1||He.isPresenting===!1||He.hasDepthSensing()===!1,ve&&Pe.addToRenderList(b,e),this.info.autoReset===!0&&this.info.reset(),fe===!0&&Me.beginShadows();let i=x.state.shadowsArray;if(Ne.render(i,e,t),fe===!0&&Me.endShadows(),(r&&w.hasRenderPass())===!1){let n=b.opaque,r=b.transmissive;if(x.setupLights(),t.isArrayCamera){let i=t.cameras;if(r.length>0)for(let t=0,a=i.length;t<a;t++){let a=i[t];rt(n,r,e,a)}ve&&Pe.render(e);for(let t=0,n=i.length;t<n;t++){let n=i[t];nt(b,e,n,n.viewport)}}else r.length>0&&rt(n,r,e,t),ve&&Pe.render(e),nt(b,e,t)}N!==null&&M===0&&(H.updateMultisampleRenderTarget(N),H.updateRenderTargetMipmap(N)),r&&w.end(T),e.isScene===!0&&e.onAfterRender(T,e,t),ze.resetDefaultState(),P=-1,ee=null,C.pop(),C.length>0?(x=C[C.length-1],H.setTextureUnits(x.state.textureUnits),fe===!0&&Me.setGlobalState(T.clippingPlanes,x.state.camera)):x=null,S.pop(),b=S.length>0?S[S.length-1]:null,D!==null&&D.renderEnd()};function tt(e,t,n,r){if(e.visible===!1)return;if(e.layers.test(t.layers)){if(e.isGroup)n=e.renderOrder;else if(e.isLOD)e.autoUpdate===!0&&e.update(t);else if(e.isLight)x.pushLight(e),e.castShadow&&x.pushShadow(e);else if(e.isSprite){let i=t.isArrayCamera?de:ue;if(!e.frustumCulled||e.intersectsFrustum(i)){r&&ge.setFromMatrixPosition(e.matrixWorld).applyMatrix4(me);let i=De.update(e),a=e.material;a.visible&&b.push(e,i,a,n,ge.z,null,t)}}else if(e.isMesh||e.isLine||e.isPoints){let i=t.isArrayCamera?de:ue;if(!e.frustumCulled||e.intersectsFrustum(i)){let i=De.update(e),a=e.material;if(r&&(e.boundingSphere===void 0?(i.boundingSphere===null&&i.computeBoundingSphere(),ge.copy(i.boundingSphere.center)):(e.boundingSphere===null&&e.computeBoundingSphere(),ge.copy(e.boundingSphere.center)),ge.applyMatrix4(e.matrixWorld).applyMatrix4(me)),Array.isArray(a)){let r=i.groups;for(let o=0,s=r.length;o<s;o++){let s=r[o],c=a[s.materialIndex];c&&c.visible&&b.push(e,i,c,n,ge.z,s,t)}}else a.visible&&b.push(e,i,a,n,ge.z,null,t)}}}let i=e.children;for(let e=0,a=i.length;e<a;e++)tt(i[e],t,n,r)}function nt(e,t,n,r){let{opaque:i,transmissive:a,transparent:o}=e;x.setupLightsView(n),fe===!0&&Me.setGlobalState(T.clippingPlanes,n),r&&B.viewport(F.copy(r)),i.length>0&&it(i,t,n),a.length>0&&it(a,t,n),o.length>0&&it(o,t,n),B.buffers.depth.setTest(!0),B.buffers.depth.setMask(!0),B.buffers.color.setMask(!0),B.setPolygonOffset(!1)}function rt(e,t,n,r){if((n.isScene===!0?n.overrideMaterial:null)!==null)return;if(x.state.transmissionRenderTarget[r.id]===void 0){let e=xe.has(`EXT_color_buffer_half_float`)||xe.has(`EXT_color_buffer_float`);x.state.transmissionRenderTarget[r.id]=new Fr(1,1,{generateMipmaps:!0,type:e?gt:lt,minFilter:ct,samples:Math.max(4,Se.samples),stencilBuffer:i,resolveDepthBuffer:!1,resolveStencilBuffer:!1,storeMultisampledDepthBuffer:!1,storeMultisampledStencilBuffer:!1,colorSpace:Sr.workingColorSpace})}let a=x.state.transmissionRenderTarget[r.id],o=r.viewport||F;a.setSize(o.z*T.transmissionResolutionScale,o.w*T.transmissionResolutionScale);let s=T.getRenderTarget(),c=T.getActiveCubeFace(),l=T.getActiveMipmapLevel();T.setRenderTarget(a),T.getClearColor(re),ie=T.getClearAlpha(),ie<1&&T.setClearColor(16777215,.5),T.clear(),ve&&Pe.render(n);let u=T.toneMapping;T.toneMapping=0;let d=r.viewport;if(r.viewport!==void 0&&(r.viewport=void 0),x.setupLightsView(r),fe===!0&&Me.setGlobalState(T.clippingPlanes,r),it(e,n,r),H.updateMultisampleRenderTarget(a),H.updateRenderTargetMipmap(a),xe.has(`WEBGL_multisampled_render_to_texture`)===!1){let e=!1;for(let i=0,a=t.length;i<a;i++){let{object:a,geometry:o,material:s,group:c}=t[i];if(s.side===2&&a.layers.test(r.layers)){let t=s.side;s.side=1,s.needsUpdate=!0,at(a,n,r,o,s,c),s.side=t,s.needsUpdate=!0,e=!0}}e===!0&&(H.updateMultisampleRenderTarget(a),H.updateRenderTargetMipmap(a))}T.setRenderTarget(s,c,l),T.setClearColor(re,ie),d!==void 0&&(r.viewport=d),T.toneMapping=u}function it(e,t,n){let r=t.isScene===!0?t.overrideMaterial:null;for(let i=0,a=e.length;i<a;i++){let a=e[i],{object:o,geometry:s,group:c}=a,l=a.material;l.allowOverride===!0&&r!==null&&(l=r),o.layers.test(n.layers)&&at(o,t,n,s,l,c)}}function at(e,t,n,r,i,a){D!==null&&i.isNodeMaterial&&D.setObject(e,i),e.onBeforeRender(T,t,n,r,i,a),e.modelViewMatrix.multiplyMatrices(n.matrixWorldInverse,e.matrixWorld),e.normalMatrix.getNormalMatrix(e.modelViewMatrix),i.onBeforeRender(T,t,n,r,e,a),i.transparent===!0&&i.side===2&&i.forceSinglePass===!1?(i.side=1,i.needsUpdate=!0,T.renderBufferDirect(n,t,r,i,e,a),i.side=0,i.needsUpdate=!0,T.renderBufferDirect(n,t,r,i,e,a),i.side=2):T.renderBufferDirect(n,t,r,i,e,a),e.onAfterRender(T,t,n,r,i,a)}function ot(e){let t=0;for(let n of e)n.texture!==null&&t++;return t}function st(e,t,n){t.isScene!==!0&&(t=_e);let r=V.get(e),i=x.state.lights,a=x.state.shadowsArray,o=i.state.version,s=Oe.getParameters(e,i.state,a,t,n,x.state.lightProbeGridArray),c=Oe.getProgramCacheKey(s),l=r.programs;r.environment=e.isMeshStandardMaterial||e.isMeshLambertMaterial||e.isMeshPhongMaterial?t.environment:null,r.fog=t.fog;let u=e.isMeshStandardMaterial||e.isMeshLambertMaterial&&!e.envMap||e.isMeshPhongMaterial&&!e.envMap;r.envMap=we.get(e.envMap||r.environment,u),r.envMapRotation=r.environment!==null&&e.envMap===null?t.environmentRotation:e.envMapRotation,l===void 0&&(e.addEventListener(`dispose`,Ke),l=new Map,r.programs=l,r.programVariants=new Map);let d=l.get(c);if(d!==void 0){if(r.currentProgram===d&&r.lightsStateVersion===o)return pt(e,s),d}else s.uniforms=Oe.getUniforms(e),D!==null&&e.isNodeMaterial&&D.build(e,n,s),e.onBeforeCompile(s,T),d=Oe.acquireProgram(s,c),l.set(c,d),r.uniforms=s.uniforms;let f=r.uniforms;return(!e.isShaderMaterial&&!e.isRawShaderMaterial||e.clipping===!0)&&(f.clippingPlanes=Me.uniform),pt(e,s),r.needsLights=xt(e),r.lightsStateVersion=o,r.needsLights&&(f.ambientLightColor.value=i.state.ambient,f.lightProbe.value=i.state.probe,f.sunLights.value=i.state.sun,f.sunLightShadows.value=i.state.sunShadow,f.directionalLights.value=i.state.directional,f.directionalLightShadows.value=i.state.directionalShadow,f.spotLights.value=i.state.spot,f.spotLightShadows.value=i.state.spotShadow,f.rectAreaLights.value=i.state.rectArea,f.ltc_1.value=i.state.rectAreaLTC1,f.ltc_2.value=i.state.rectAreaLTC2,f.pointLights.value=i.state.point,f.pointLightShadows.value=i.state.pointShadow,f.hemisphereLights.value=i.state.hemi,f.sunShadowMatrix.value=i.state.sunShadowMatrix,f.sunShadowCascade.value=i.state.sunShadowCascade,f.directionalShadowMatrix.value=i.state.directionalShadowMatrix,f.spotLightMatrix.value=i.state.spotLightMatrix,f.spotLightMap.value=i.state.spotLightMap,f.pointShadowMatrix.value=i.state.pointShadowMatrix),r.numLightProbeGrids=ot(x.state.lightProbeGridArray),r.currentProgram=d,r.uniformsList=null,d}function ut(e,t,n,r,i){let a=V.get(e),o=a.currentProgram.id+`,`+r+`,`+i,s=a.programVariants.get(o);return s===void 0?(s=st(e,t,n),a.programVariants.set(o,s)):(a.currentProgram=s,a.uniformsList=null,a.outputColorSpace=r,a.toneMapping=i),s}function dt(e){if(e.uniformsList===null){let t=e.currentProgram.getUniforms();e.uniformsList=cd.seqWithValue(t.seq,e.uniforms)}return e.uniformsList}function pt(e,t){let n=V.get(e);n.outputColorSpace=t.outputColorSpace,n.batching=t.batching,n.batchingColor=t.batchingColor,n.instancing=t.instancing,n.instancingColor=t.instancingColor,n.instancingMorph=t.instancingMorph,n.skinning=t.skinning,n.morphTargets=t.morphTargets,n.morphNormals=t.morphNormals,n.morphColors=t.morphColors,n.morphTargetsCount=t.morphTargetsCount,n.numClippingPlanes=t.numClippingPlanes,n.numIntersection=t.numClipIntersection,n.vertexAlphas=t.vertexAlphas,n.vertexTangents=t.vertexTangents,n.toneMapping=t.toneMapping}function ht(e,t,n,r,i){t.isScene!==!0&&(t=_e),H.resetTextureUnits();let a=t.fog,o=r.isMeshStandardMaterial||r.isMeshLambertMaterial||r.isMeshPhongMaterial?t.environment:null,s=N===null?T.outputColorSpace:N.isXRRenderTarget===!0?N.texture.colorSpace:Sr.workingColorSpace,c=r.isMeshStandardMaterial||r.isMeshLambertMaterial&&!r.envMap||r.isMeshPhongMaterial&&!r.envMap,l=we.get(r.envMap||o,c),u=r.vertexColors===!0&&!!n.attributes.color&&n.attributes.color.itemSize===4,d=!!n.attributes.tangent&&(!!r.normalMap||r.anisotropy>0),f=!!n.morphAttributes.position,p=!!n.morphAttributes.normal,m=!!n.morphAttributes.color,h=0;r.toneMapped&&(N===null||N.isXRRenderTarget===!0)&&(h=T.toneMapping);let g=n.morphAttributes.position||n.morphAttributes.normal||n.morphAttributes.color,_=g===void 0?0:g.length,v=V.get(r),b=x.state.lights;if(fe===!0&&(pe===!0||e!==ee)){let t=e===ee&&r.id===P;Me.setState(r,e,t)}let S=!1,C=!1;r.version===v.__version?v.needsLights&&v.lightsStateVersion!==b.state.version||i.isBatchedMesh&&v.batching===!1||!i.isBatchedMesh&&v.batching===!0||i.isBatchedMesh&&v.batchingColor===!0&&i._colorsTexture===null||i.isBatchedMesh&&v.batchingColor===!1&&i._colorsTexture!==null||i.isInstancedMesh&&v.instancing===!1||!i.isInstancedMesh&&v.instancing===!0||i.isSkinnedMesh&&v.skinning===!1||!i.isSkinnedMesh&&v.skinning===!0||i.isInstancedMesh&&v.instancingColor===!0&&i.instanceColor===null||i.isInstancedMesh&&v.instancingColor===!1&&i.instanceColor!==null||i.isInstancedMesh&&v.instancingMorph===!0&&i.morphTexture===null||i.isInstancedMesh&&v.instancingMorph===!1&&i.morphTexture!==null?S=!0:v.envMap===l?r.fog===!0&&v.fog!==a||v.numClippingPlanes!==void 0&&(v.numClippingPlanes!==Me.numPlanes||v.numIntersection!==Me.numIntersection)?S=!0:v.vertexAlphas===u&&v.vertexTangents===d&&v.morphTargets===f&&v.morphNormals===p&&v.morphColors===m&&v.morphTargetsCount===_&&v.numLightProbeGrids===ot(x.state.lightProbeGridArray)?(v.outputColorSpace!==s||v.toneMapping!==h)&&(C=!0):S=!0:S=!0:(S=!0,v.__version=r.version);let w=v.currentProgram;(S===!0||C===!0)&&(w=C===!0?ut(r,t,i,s,h):st(r,t,i),D&&r.isNodeMaterial&&D.onUpdateProgram(r,w,v));let E=!1,O=!1,k=!1,A=w.getUniforms(),j=v.uniforms;if(B.useProgram(w.program)&&(E=!0,O=!0,k=!0),r.id!==P&&(P=r.id,O=!0),E||ee!==e){B.buffers.depth.getReversed()&&e.reversedDepth!==!0&&(e._reversedDepth=!0,e.updateProjectionMatrix()),A.setValue(z,`projectionMatrix`,e.projectionMatrix),A.setValue(z,`viewMatrix`,e.matrixWorldInverse);let t=A.map.cameraPosition;t!==void 0&&t.setValue(z,he.setFromMatrixPosition(e.matrixWorld)),Se.logarithmicDepthBuffer&&A.setValue(z,`logDepthBufFC`,2/(Math.log(e.far+1)/Math.LN2)),(r.isMeshPhongMaterial||r.isMeshToonMaterial||r.isMeshLambertMaterial||r.isMeshBasicMaterial||r.isMeshStandardMaterial||r.isShaderMaterial)&&A.setValue(z,`isOrthographic`,e.isOrthographicCamera===!0),ee!==e&&(ee=e,O=!0,k=!0)}if(v.needsLights&&(b.state.sunShadowMap.length>0&&A.setValue(z,`sunShadowMap`,b.state.sunShadowMap,H),b.state.directionalShadowMap.length>0&&A.setValue(z,`directionalShadowMap`,b.state.directionalShadowMap,H),b.state.spotShadowMap.length>0&&A.setValue(z,`spotShadowMap`,b.state.spotShadowMap,H),b.state.pointShadowMap.length>0&&A.setValue(z,`pointShadowMap`,b.state.pointShadowMap,H)),i.isSkinnedMesh){A.setOptional(z,i,`bindMatrix`),A.setOptional(z,i,`bindMatrixInverse`);let e=i.skeleton;e&&(e.boneTexture===null&&e.computeBoneTexture(),A.setValue(z,`boneTexture`,e.boneTexture,H))}i.isBatchedMesh&&(A.setOptional(z,i,`batchingTexture`),A.setValue(z,`batchingTexture`,i._matricesTexture,H),A.setOptional(z,i,`batchingIdTexture`),A.setValue(z,`batchingIdTexture`,i._indirectTexture,H),A.setOptional(z,i,`batchingColorTexture`),i._colorsTexture!==null&&A.setValue(z,`batchingColorTexture`,i._colorsTexture,H));let M=n.morphAttributes;if((M.position!==void 0||M.normal!==void 0||M.color!==void 0)&&Fe.update(i,n,w),(O||v.receiveShadow!==i.receiveShadow)&&(v.receiveShadow=i.receiveShadow,A.setValue(z,`receiveShadow`,i.receiveShadow)),(r.isMeshStandardMaterial||r.isMeshLambertMaterial||r.isMeshPhongMaterial)&&r.envMap===null&&t.environment!==null&&(j.envMapIntensity.value=t.environmentIntensity),j.dfgLUT!==void 0&&(j.dfgLUT.value=Ef()),O){if(A.setValue(z,`toneMappingExposure`,T.toneMappingExposure),v.needsLights&&bt(j,k),a&&r.fog===!0&&ke.refreshFogUniforms(j,a),ke.refreshMaterialUniforms(j,r,oe,ae,x.state.transmissionRenderTarget[e.id]),v.needsLights&&v.numLightProbeGrids>0){let e=y,t=0;for(let n of x.state.lightProbeGridArray)n.texture!==null&&(e.textures[t]=n.texture,e.min[t]=n.boundingBox.min,e.max[t]=n.boundingBox.max,e.resolution[t]=n.resolution,t++);for(let n in e)e[n].length=t;j.probesSH.value=e.textures,j.probesMin.value=e.min,j.probesMax.value=e.max,j.probesResolution.value=e.resolution}cd.upload(z,dt(v),j,H)}if(r.isShaderMaterial&&r.uniformsNeedUpdate===!0&&(cd.upload(z,dt(v),j,H),r.uniformsNeedUpdate=!1),r.isSpriteMaterial&&A.setValue(z,`center`,i.center),A.setValue(z,`modelViewMatrix`,i.modelViewMatrix),A.setValue(z,`normalMatrix`,i.normalMatrix),A.setValue(z,`modelMatrix`,i.matrixWorld),r.uniformsGroups!==void 0){let e=r.uniformsGroups;for(let t=0,n=e.length;t<n;t++){let n=e[t];Be.update(n,w),Be.bind(n,w)}}return w}function bt(e,t){e.ambientLightColor.needsUpdate=t,e.lightProbe.needsUpdate=t,e.sunLights.needsUpdate=t,e.sunLightShadows.needsUpdate=t,e.directionalLights.needsUpdate=t,e.directionalLightShadows.needsUpdate=t,e.pointLights.needsUpdate=t,e.pointLightShadows.needsUpdate=t,e.spotLights.needsUpdate=t,e.spotLightShadows.needsUpdate=t,e.rectAreaLights.needsUpdate=t,e.hemisphereLights.needsUpdate=t}function xt(e){return e.isMeshLambertMaterial||e.isMeshToonMaterial||e.isMeshPhongMaterial||e.isMeshStandardMaterial||e.isShadowMaterial||e.isShaderMaterial&&e.lights===!0}this.getActiveCubeFace=function(){return j},this.getActiveMipmapLevel=function(){return M},this.getRenderTarget=function(){return N},this.setRenderTargetTextures=function(e,t,n){let r=V.get(e);r.__autoAllocateDepthBuffer=e.resolveDepthBuffer===!1,r.__autoAllocateDepthBuffer===!1&&(r.__useRenderToTexture=!1),V.get(e.texture).__webglTexture=t,V.get(e.depthTexture).__webglTexture=r.__autoAllocateDepthBuffer?void 0:n,r.__hasExternalTextures=!0},this.setRenderTargetFramebuffer=function(e,t){let n=V.get(e);n.__webglFramebuffer=t,n.__useDefaultFramebuffer=t===void 0},this.setRenderTarget=function(e,t=0,n=0){N=e,j=t,M=n;let r=null,i=!1,a=!1;if(e){let o=V.get(e);if(o.__useDefaultFramebuffer!==void 0){B.bindFramebuffer(z.FRAMEBUFFER,o.__webglFramebuffer),F.copy(e.viewport),te.copy(e.scissor),ne=e.scissorTest,B.viewport(F),B.scissor(te),B.setScissorTest(ne),P=-1;return}if(o.__webglFramebuffer===void 0)H.setupRenderTarget(e);else if(o.__hasExternalTextures)H.rebindTextures(e,V.get(e.texture).__webglTexture,V.get(e.depthTexture).__webglTexture);else if(e.depthBuffer){let t=e.depthTexture;if(o.__boundDepthTexture!==t){if(t!==null&&V.has(t)&&(e.width!==t.image.width||e.height!==t.image.height))throw Error(`THREE.WebGLRenderer: Attached DepthTexture is initialized to the incorrect size.`);H.setupDepthRenderbuffer(e)}}let s=e.texture;(s.isData3DTexture||s.isDataArrayTexture||s.isCompressedArrayTexture)&&(a=!0);let c=V.get(e).__webglFramebuffer;e.isWebGLCubeRenderTarget?(r=Array.isArray(c[t])?c[t][n]:c[t],i=!0):r=e.samples>0&&H.useMultisampledRTT(e)===!1?V.get(e).__webglMultisampledFramebuffer:Array.isArray(c)?c[n]:c,F.copy(e.viewport),te.copy(e.scissor),ne=e.scissorTest}else F.copy(se).multiplyScalar(oe).floor(),te.copy(ce).multiplyScalar(oe).floor(),ne=le;if(n!==0&&(r=O),B.bindFramebuffer(z.FRAMEBUFFER,r)&&B.drawBuffers(e,r),B.viewport(F),B.scissor(te),B.setScissorTest(ne),i){let r=V.get(e.texture);z.framebufferTexture2D(z.FRAMEBUFFER,z.COLOR_ATTACHMENT0,z.TEXTURE_CUBE_MAP_POSITIVE_X+t,r.__webglTexture,n)}else if(a){let r=t;for(let t=0;t<e.textures.length;t++){let i=V.get(e.textures[t]);z.framebufferTextureLayer(z.FRAMEBUFFER,z.COLOR_ATTACHMENT0+t,i.__webglTexture,n,r)}}else if(e!==null&&n!==0){let t=V.get(e.texture);z.framebufferTexture2D(z.FRAMEBUFFER,z.COLOR_ATTACHMENT0,z.TEXTURE_2D,t.__webglTexture,n)}P=-1};function St(e){let t=V.get(e);return(t.__readFormat!==e.format||t.__readType!==e.type)&&(t.__readFormat=e.format,t.__readType=e.type,t.__formatReadable=Se.textureFormatReadable(e.format),t.__typeReadable=Se.textureTypeReadable(e.type)),t}this.readRenderTargetPixels=function(e,t,n,r,i,a,o,s=0){if(!(e&&e.isWebGLRenderTarget)){W(`WebGLRenderer.readRenderTargetPixels: renderTarget is not THREE.WebGLRenderTarget.`);return}let c=V.get(e).__webglFramebuffer;if(e.isWebGLCubeRenderTarget&&o!==void 0&&(c=c[o],Array.isArray(c)&&(c=c[0])),c){B.bindFramebuffer(z.FRAMEBUFFER,c);try{let o=e.textures[s],c=o.format,l=o.type;e.textures.length>1&&z.readBuffer(z.COLOR_ATTACHMENT0+s);let u=St(o);if(u.__formatReadable===!1){W(`WebGLRenderer.readRenderTargetPixels: renderTarget is not in RGBA or implementation defined format.`);return}if(u.__typeReadable===!1){W(`WebGLRenderer.readRenderTargetPixels: renderTarget is not in UnsignedByteType or implementation defined type.`);return}t>=0&&t<=e.width-r&&n>=0&&n<=e.height-i&&z.readPixels(t,n,r,i,Re.convert(c),Re.convert(l),a)}finally{let e=N===null?null:V.get(N).__webglFramebuffer;B.bindFramebuffer(z.FRAMEBUFFER,e)}}},this.readRenderTargetPixelsAsync=async function(e,t,n,r,i,a,o,s=0){if(!(e&&e.isWebGLRenderTarget))throw Error(`THREE.WebGLRenderer.readRenderTargetPixels: renderTarget is not THREE.WebGLRenderTarget.`);let c=V.get(e).__webglFramebuffer;if(e.isWebGLCubeRenderTarget&&o!==void 0&&(c=c[o],Array.isArray(c)&&(c=c[0])),c){if(t>=0&&t<=e.width-r&&n>=0&&n<=e.height-i){B.bindFramebuffer(z.FRAMEBUFFER,c);let o=e.textures[s],l=o.format,u=o.type;e.textures.length>1&&z.readBuffer(z.COLOR_ATTACHMENT0+s);let d=St(o);if(d.__formatReadable===!1)throw Error(`THREE.WebGLRenderer.readRenderTargetPixelsAsync: renderTarget is not in RGBA or implementation defined format.`);if(d.__typeReadable===!1)throw Error(`THREE.WebGLRenderer.readRenderTargetPixelsAsync: renderTarget is not in UnsignedByteType or implementation defined type.`);let f=z.createBuffer();z.bindBuffer(z.PIXEL_PACK_BUFFER,f),z.bufferData(z.PIXEL_PACK_BUFFER,a.byteLength,z.STREAM_READ),z.readPixels(t,n,r,i,Re.convert(l),Re.convert(u),0),z.bindBuffer(z.PIXEL_PACK_BUFFER,null);let p=N===null?null:V.get(N).__webglFramebuffer;B.bindFramebuffer(z.FRAMEBUFFER,p);let m=z.fenceSync(z.SYNC_GPU_COMMANDS_COMPLETE,0);return z.flush(),await zn(z,m,4),z.bindBuffer(z.PIXEL_PACK_BUFFER,f),z.getBufferSubData(z.PIXEL_PACK_BUFFER,0,a),z.bindBuffer(z.PIXEL_PACK_BUFFER,null),z.deleteBuffer(f),z.deleteSync(m),a}throw Error(`THREE.WebGLRenderer.readRenderTargetPixelsAsync: requested read bounds are out of range.`)}},this.copyFramebufferToTexture=function(e,t=null,n=0){let r=2**-n,i=Math.floor(e.image.width*r),a=Math.floor(e.image.height*r),o=t===null?0:t.x,s=t===null?0:t.y;H.setTexture2D(e,0),z.copyTexSubImage2D(z.TEXTURE_2D,n,0,0,o,s,i,a),B.unbindTexture()},this.copyTextureToTexture=function(e,t,n=null,r=null,i=0,a=0){let o,s,c,l,u,d,f,p,m,h=e.isCompressedTexture?e.mipmaps[a]:e.image;if(n!==null)o=n.max.x-n.min.x,s=n.max.y-n.min.y,c=n.isBox3?n.max.z-n.min.z:1,l=n.min.x,u=n.min.y,d=n.isBox3?n.min.z:0;else{let t=2**-i;o=Math.floor(h.width*t),s=Math.floor(h.height*t),c=e.isDataArrayTexture?h.depth:e.isData3DTexture?Math.floor(h.depth*t):1,l=0,u=0,d=0}r===null?(f=0,p=0,m=0):(f=r.x,p=r.y,m=r.z);let g=Re.convert(t.format),_=Re.convert(t.type),v;t.isData3DTexture?(H.setTexture3D(t,0),v=z.TEXTURE_3D):t.isDataArrayTexture||t.isCompressedArrayTexture?(H.setTexture2DArray(t,0),v=z.TEXTURE_2D_ARRAY):(H.setTexture2D(t,0),v=z.TEXTURE_2D),B.activeTexture(z.TEXTURE0),B.pixelStorei(z.UNPACK_FLIP_Y_WEBGL,t.flipY),B.pixelStorei(z.UNPACK_PREMULTIPLY_ALPHA_WEBGL,t.premultiplyAlpha),B.pixelStorei(z.UNPACK_ALIGNMENT,t.unpackAlignment);let y=B.getParameter(z.UNPACK_ROW_LENGTH),b=B.getParameter(z.UNPACK_IMAGE_HEIGHT),x=B.getParameter(z.UNPACK_SKIP_PIXELS),S=B.getParameter(z.UNPACK_SKIP_ROWS),C=B.getParameter(z.UNPACK_SKIP_IMAGES);B.pixelStorei(z.UNPACK_ROW_LENGTH,h.width),B.pixelStorei(z.UNPACK_IMAGE_HEIGHT,h.height),B.pixelStorei(z.UNPACK_SKIP_PIXELS,l),B.pixelStorei(z.UNPACK_SKIP_ROWS,u),B.pixelStorei(z.UNPACK_SKIP_IMAGES,d);let w=e.isDataArrayTexture||e.isData3DTexture,T=t.isDataArrayTexture||t.isData3DTexture;if(e.isDepthTexture){let n=V.get(e),r=V.get(t),h=V.get(n.__renderTarget),g=V.get(r.__renderTarget);B.bindFramebuffer(z.READ_FRAMEBUFFER,h.__webglFramebuffer),B.bindFramebuffer(z.DRAW_FRAMEBUFFER,g.__webglFramebuffer);for(let n=0;n<c;n++)w&&(z.framebufferTextureLayer(z.READ_FRAMEBUFFER,z.COLOR_ATTACHMENT0,V.get(e).__webglTexture,i,d+n),z.framebufferTextureLayer(z.DRAW_FRAMEBUFFER,z.COLOR_ATTACHMENT0,V.get(t).__webglTexture,a,m+n)),z.blitFramebuffer(l,u,l+o,u+s,f,p,f+o,p+s,z.DEPTH_BUFFER_BIT,z.NEAREST);B.bindFramebuffer(z.READ_FRAMEBUFFER,null),B.bindFramebuffer(z.DRAW_FRAMEBUFFER,null)}else if(i!==0||e.isRenderTargetTexture||V.has(e)){let n=V.get(e),r=V.get(t);B.bindFramebuffer(z.READ_FRAMEBUFFER,k),B.bindFramebuffer(z.DRAW_FRAMEBUFFER,A);for(let e=0;e<c;e++)w?z.framebufferTextureLayer(z.READ_FRAMEBUFFER,z.COLOR_ATTACHMENT0,n.__webglTexture,i,d+e):z.framebufferTexture2D(z.READ_FRAMEBUFFER,z.COLOR_ATTACHMENT0,z.TEXTURE_2D,n.__webglTexture,i),T?z.framebufferTextureLayer(z.DRAW_FRAMEBUFFER,z.COLOR_ATTACHMENT0,r.__webglTexture,a,m+e):z.framebufferTexture2D(z.DRAW_FRAMEBUFFER,z.COLOR_ATTACHMENT0,z.TEXTURE_2D,r.__webglTexture,a),i===0?T?z.copyTexSubImage3D(v,a,f,p,m+e,l,u,o,s):z.copyTexSubImage2D(v,a,f,p,l,u,o,s):z.blitFramebuffer(l,u,l+o,u+s,f,p,f+o,p+s,z.COLOR_BUFFER_BIT,z.NEAREST);B.bindFramebuffer(z.READ_FRAMEBUFFER,null),B.bindFramebuffer(z.DRAW_FRAMEBUFFER,null)}else T?e.isDataTexture||e.isData3DTexture?z.texSubImage3D(v,a,f,p,m,o,s,c,g,_,h.data):t.isCompressedArrayTexture?z.compressedTexSubImage3D(v,a,f,p,m,o,s,c,g,h.data):z.texSubImage3D(v,a,f,p,m,o,s,c,g,_,h):e.isDataTexture?z.texSubImage2D(z.TEXTURE_2D,a,f,p,o,s,g,_,h.data):e.isCompressedTexture?z.compressedTexSubImage2D(z.TEXTURE_2D,a,f,p,h.width,h.height,g,h.data):z.texSubImage2D(z.TEXTURE_2D,a,f,p,o,s,g,_,h);B.pixelStorei(z.UNPACK_ROW_LENGTH,y),B.pixelStorei(z.UNPACK_IMAGE_HEIGHT,b),B.pixelStorei(z.UNPACK_SKIP_PIXELS,x),B.pixelStorei(z.UNPACK_SKIP_ROWS,S),B.pixelStorei(z.UNPACK_SKIP_IMAGES,C),a===0&&t.generateMipmaps===!0&&t.mipmapsAutoUpdate===!0&&z.generateMipmap(v),B.unbindTexture()},this.initRenderTarget=function(e){V.get(e).__webglFramebuffer===void 0&&H.setupRenderTarget(e)},this.initTexture=function(e){e.isCubeTexture?H.setTextureCube(e,0):e.isData3DTexture?H.setTexture3D(e,0):e.isDataArrayTexture||e.isCompressedArrayTexture?H.setTexture2DArray(e,0):H.setTexture2D(e,0),B.unbindTexture()},this.resetState=function(){j=0,M=0,N=null,B.reset(),ze.reset()},typeof __THREE_DEVTOOLS__<`u`&&__THREE_DEVTOOLS__.dispatchEvent(new CustomEvent(`observe`,{detail:this}))}get coordinateSystem(){return An}get outputColorSpace(){return this._outputColorSpace}set outputColorSpace(e){this._outputColorSpace=e;let t=this.getContext();t.drawingBufferColorSpace=Sr._getDrawingBufferColorSpace(e),t.unpackColorSpace=Sr._getUnpackColorSpace()}},Of=1.4,kf=18;function Af(e,t){let n=new bi,r=new Fr(1,1,{type:gt,depthTexture:new jo(1,1)}),i=new uc({vertexShader:`varying vec2 vAt; void main() { vAt = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }`,fragmentShader:jf,uniforms:{colours:{value:r.texture},depths:{value:r.depthTexture},reach:{value:new K},range:{value:new Nr}}}),a=new Ha(new Qs(2,2),i);a.frustumCulled=!1,a.renderOrder=-2,a.visible=!1,e.scene.add(a);let o=new K,s=!1;return e.beforeDraw(()=>{let c=s&&!e.quality.plain?n:e.scene;if(t.parent!==c&&c.add(t),a.visible=t.parent===n&&t.visible,!a.visible)return;let{renderer:l,camera:u,plan:d}=e;l.getDrawingBufferSize(o),r.setSize(o.x,o.y),i.uniforms.reach.value.set(1,1).divide(o).multiplyScalar(Of*l.getPixelRatio()),i.uniforms.range.value.set(u.near,u.far,+!!d,kf),l.setRenderTarget(r),l.clear(),l.render(n,u),l.setRenderTarget(null)}),e=>void(s=e)}var jf=`
uniform sampler2D colours;
uniform sampler2D depths;
uniform vec2 reach;
uniform vec4 range;  // near, far, whether it is a plan, strength
varying vec2 vAt;
float metres(float depth) {
  return range.z > 0.5 ? mix(range.x, range.y, depth) : range.x * range.y / (range.y - depth * (range.y - range.x));
}
float nearer(float here, vec2 by) {
  float there = texture2D(depths, vAt + by * reach).x;
  return there < 1.0 ? max(0.0, (here - metres(there)) / (range.z > 0.5 ? 60.0 : here)) : 0.0;
}
void main() {
  float depth = texture2D(depths, vAt).x;
  if (depth >= 1.0) discard;
  float here = metres(depth);
  float behind = nearer(here, vec2(1, 0)) + nearer(here, vec2(-1, 0)) + nearer(here, vec2(0, 1)) + nearer(here, vec2(0, -1));
  vec4 colour = texture2D(colours, vAt);
  gl_FragColor = vec4(colour.rgb * exp(-range.w * min(behind, 0.2)), colour.a);
  gl_FragDepth = depth;
  #include <colorspace_fragment>
}`,Mf=1e6,Nf=3e6,Pf=1.4,Ff=6,If=6e4,Lf=200,Rf=4096,zf=128,Bf=.05;function Vf(e,t){let n=new fi;e.scene.add(n);let r=qf();n.add(Hf(r));let i=new io,a=new Rr,o=new q,s=[],c=()=>Promise.reject(Error(`no map`)),l=!0,u=0,d=0,f=0,p=[],m=0,h=0;e.beforeDraw(()=>{n.visible=l&&s.length>0,r.uniforms.ground.value=e.ground,n.visible?(f+=1,_(Mf*e.quality.share),v()):e.canvas.dataset.points=`0`});let g=Af(e,n);function _(t){let{camera:n}=e;i.setFromProjectionMatrix(a.multiplyMatrices(n.projectionMatrix,n.matrixWorldInverse));let r=[];for(let t of s){if(t.points&&(t.points.visible=!1),!i.intersectsBox(t.box))continue;let a=Math.max(t.box.clampPoint(n.position,o).distanceTo(n.position),.5),s=t.coarser_m*e.pixelsAtDepth(a);s>Pf&&r.push([s,t])}r.sort((e,t)=>t[0]-e[0]);let c=0,l=0;p=[];for(let[,e]of r){if(c+e.count>t)break;c+=e.count,e.usedAt=f,e.points?(e.points.visible=!0,l+=e.count):e.state===`absent`&&p.push(e)}e.canvas.dataset.points=String(l)}function v(){for(;u<Ff;){let e=p.shift();if(!e)break;e.state===`absent`&&(e.state=`loading`,u+=1,y(e,m))}e.canvas.dataset.loading=String(u+p.length)}async function y(i,a){try{let e=await c(i.sha256);if(a!==m)return;i.points=Wf(i,new Uint8Array(e),r),i.state=`there`,d+=i.count,n.add(i.points),b()}catch(e){if(a!==m)return;i.state=`failed`,t(e)}finally{if(a===m){--u,v();let t=u?Lf:0;h&&t||(window.clearTimeout(h),h=window.setTimeout(()=>{h=0,e.draw()},t))}}}function b(){if(d<=Nf)return;let e=s.filter(e=>e.points&&e.usedAt<f).sort((e,t)=>e.usedAt-t.usedAt);for(let t of e){if(d<=Nf)return;x(t)}}function x(e){e.points&&(n.remove(e.points),e.points.geometry.dispose(),e.points=null,e.state=`absent`,d-=e.count)}return{setTiles(t,n){m+=1,u=0,p=[],s.forEach(x),d=0,c=n;let r=t.reduce((e,t)=>Math.min(e,t.level),1/0);s=t.map(e=>{let t=Rf/2**e.level,[n,i,a]=e.origin_m;return{sha256:e.sha256,count:e.points,points:null,state:`absent`,usedAt:0,box:new Fi(new q(n,i,a),new q(n+t,i+t,e.high_m)),coarser_m:e.level===r?1/0:2*t/zf,origin:new q(n,i,a),scale:new q(...e.scale_m)}});let i=0;p=s.filter(e=>(i+=e.count)<=If),v(),e.draw()},setVisible(t){l=t,e.draw()},setStyle({dark:t,bright:n,heights:i},{colouring:a,size:o,opacity:s,shading:c}){g(c);let l=r.uniforms;[t,n,...i].forEach((e,t)=>l[[`dark`,`bright`,`low`,`middle`,`high`][t]].value.set(e)),l.colouring.value=[`intensity`,`height`,`one`].indexOf(a),l.size.value=o,l.opacity.value=s,r.transparent=s<1,e.draw()}}}function Hf(e){let t=new ma;for(let[e,n]of[[`position`,3],[`shade`,1]])t.setAttribute(e,new $i(new Float32Array(n),n));let n=new Do(t,e);return n.visible=!1,n}function Uf(e){let t=Math.floor(e.length/7),n=new Uint16Array(t*4);for(let r=0;r<3;r++){let[i,a]=[2*r*t,(2*r+1)*t],o=0;for(let s=0;s<t;s++){let t=(e[i+s]??0)|(e[a+s]??0)<<8;o=o+(t>>1^-(t&1))&65535,n[4*s+r]=o}}for(let r=0;r<t;r++)n[4*r+3]=e[6*t+r]??0;return n}function Wf(e,t,n){if(t.length!==7*e.count)throw Error(`A tile has ${t.length} bytes instead of ${7*e.count}.`);let r=new ha(Uf(t),4),i=new Do(new ma().setAttribute(`position`,new va(r,3,0)).setAttribute(`shade`,new va(r,1,3)),n);return i.frustumCulled=!1,i.matrixAutoUpdate=!1,i.matrix.makeScale(e.scale.x,e.scale.y,e.scale.z).setPosition(e.origin),i.matrixWorldNeedsUpdate=!0,i.visible=!1,i}var Gf=`
attribute float shade;
uniform vec3 dark;
uniform vec3 bright;
uniform vec3 low;
uniform vec3 middle;
uniform vec3 high;
uniform float colouring;
uniform float ground;
uniform float perMetre;
uniform float least;
varying vec3 vTint;
void main() {
  vec4 seen = modelViewMatrix * vec4(position, 1.0);
  gl_Position = projectionMatrix * seen;
  // Half a metre farther in depth: LiDAR points of a cone do not hide the cone.
  vec4 farther = projectionMatrix * vec4(seen.xy, seen.z - 0.5, 1.0);
  gl_Position.z = farther.z / farther.w * gl_Position.w;
  gl_PointSize = clamp(perMetre / max(gl_Position.w, 0.01), least, 3.0 * least);
  if (colouring < 0.5) vTint = mix(dark, bright, shade / 255.0);
  else if (colouring > 1.5) vTint = mix(dark, bright, 0.4);
  else {
    float up = clamp(((modelMatrix * vec4(position, 1.0)).z - ground) / 6.0, 0.0, 1.0);
    vTint = up < 0.5 ? mix(low, middle, 2.0 * up) : mix(middle, high, 2.0 * up - 1.0);
  }
}`,Kf=`
uniform float opacity;
varying vec3 vTint;
void main() {
  if (distance(gl_PointCoord, vec2(0.5)) > 0.5) discard;  // round, also from near
  gl_FragColor = vec4(vTint, opacity);
  #include <colorspace_fragment>
}`;function qf(){let e=new uc({vertexShader:Gf,fragmentShader:Kf,uniforms:{...Object.fromEntries([`dark`,`bright`,`low`,`middle`,`high`].map(e=>[e,{value:new Y}])),perMetre:{value:1},least:{value:1.5},size:{value:1},opacity:{value:1},colouring:{value:0},ground:{value:0}}});return e.onBeforeRender=(t,n,r)=>{let i=t.getPixelRatio(),a=t.domElement.height,o=e.uniforms.size.value,s=r.projectionMatrix.elements[5]??1;e.uniforms.perMetre.value=Bf*o*a*s/2,e.uniforms.least.value=1.4*i*o,e.uniformsNeedUpdate=!0},e}var Jf={light:{background:`#eef1f4`,gridMinor:`#dde2e8`,gridMajor:`#c3cbd4`,path:`#4a5560`,camera:`#00795c`,ellipse:`#0068b4`,dark:`#a9a294`,bright:`#dcd7cc`,heights:[`#cfc9bd`,`#7fa3b5`,`#3b5c8a`],line:`#8a7443`,halo:`#ffffff`,rim:`#5c6670`},dark:{background:`#12181f`,gridMinor:`#1d252e`,gridMajor:`#2c3742`,path:`#9fabb7`,camera:`#3fc79f`,ellipse:`#5fb4ee`,dark:`#393d40`,bright:`#76746c`,heights:[`#4c4f52`,`#4f7f97`,`#9cc4ea`],line:`#a58f5c`,halo:`#0b0f14`,rim:`#0b0f14`}},Yf={light:{dark:`#eeb4ae`,bright:`#c2281d`,line:`#12833a`,added:`#0a45d6`},dark:{dark:`#6e1d18`,bright:`#f2564a`,line:`#37d067`,added:`#5d92ff`}},Xf=`conetl-theme`,Zf=window.matchMedia(`(prefers-color-scheme: dark)`),Qf=[],$f=ep();function ep(){try{return localStorage.getItem(Xf)}catch{return null}}var tp=()=>$f===null?Zf.matches:$f===`dark`,np=!1,rp=()=>np?Yf[tp()?`dark`:`light`]:null,ip=()=>({...Jf[tp()?`dark`:`light`],...rp()}),ap=()=>rp()?.added??null,op=e=>e===`added`&&ap()||(tp()?L[e].dark:L[e].colour),sp=e=>`var(--kind-${e})`,cp=e=>void Qf.push(e);function lp(){let e=document.documentElement;e.dataset.theme=tp()?`dark`:`light`;for(let[t,n]of[[`--points`,ip().dark],[`--lines`,ip().line]])e.style.setProperty(t,n);for(let t of R)e.style.setProperty(`--kind-${t}`,op(t));for(let e of Qf)e()}function up(e){e!==np&&(np=e,lp())}function dp(){let e=_(`button`,{type:`button`,class:`link theme`,id:`theme`}),t=()=>{e.textContent=tp()?`Light`:`Dark`,e.title=tp()?`Switch to light colours`:`Switch to dark colours`};return e.addEventListener(`click`,()=>{let e=tp()?`light`:`dark`;$f=e===`dark`===Zf.matches?null:e;try{$f===null?localStorage.removeItem(Xf):localStorage.setItem(Xf,$f)}catch{}lp()}),cp(t),t(),e}Zf.addEventListener(`change`,lp),lp();function fp(e,t){let n=Vf(e,t),r=vp(e),i=0;return{async open(a){let o=++i,[s,c]=await Promise.all([g.base(a),g.baseLines(a)]);return o===i?(n.setTiles(s.tiles,e=>g.baseTile(a,e)),r.show(c.lines),e.warm(),document.documentElement.dataset.lines=String(c.lines.length),(s.truncated||c.truncated)&&t(Error(`The base layers are too large for this page: some of them are not shown.`)),s.layers):[]},close(){i+=1,n.setTiles([],()=>Promise.reject(Error(`no map`))),r.show([])},apply(e){n.setStyle(ip(),e.scene),r.setColour(ip().line),n.setVisible(e.points),r.setVisible(e.lines)}}}var pp=.05,mp=.01,hp=new q,gp={painted:{width_px:1.5,dashed:0,faint:0},dashed:{width_px:1.5,dashed:1,faint:0},edge:{width_px:1.2,dashed:0,faint:.2},virtual:{width_px:1,dashed:0,faint:.6}};function _p({kind:e,subtype:t}){let n=`${e} ${t??``}`.toLowerCase();return/virtual|reference|lane_border|centerline/.test(n)?`virtual`:/dashed|broken/.test(n)?`dashed`:/curb|kerb|border|wall|fence|guard|rail|edge|grass/.test(n)?`edge`:`painted`}function vp(e){let t=new uc({vertexShader:Sp,fragmentShader:Cp,side:2,uniforms:{colour:{value:new Y},background:{value:new Y},canvas:{value:new K}}});t.onBeforeRender=({domElement:{clientWidth:e,clientHeight:n}})=>{t.uniforms.canvas.value.set(e,n),t.uniformsNeedUpdate=!0};let n=new Ha(new ma,t);return n.frustumCulled=!1,e.scene.add(n),{show(t){n.geometry.dispose(),n.geometry=xp(t),e.draw()},setVisible(t){n.visible=t,e.draw()},setColour(n){t.uniforms.colour.value.set(n),t.uniforms.background.value.set(ip().background),e.draw()}}}var yp=({xyz_m:e})=>Array.from({length:e.length/3},(t,n)=>new q(...e.slice(3*n,3*n+3)));function bp(e){let[t,n]=[e[0],e.at(-1)];if(!t||!n||e.length<3)return e;let r=new pl(t,n),[i,a]=[0,mp];return e.forEach((e,t)=>{let n=r.closestPointToPoint(e,!0,hp).distanceTo(e);n>a&&([i,a]=[t,n])}),i?[...bp(e.slice(0,i+1)),...bp(e.slice(i)).slice(1)]:[t,n]}function xp(e){let t=e.map(e=>({style:gp[_p(e)],vertices:bp(yp(e))})),n=t.reduce((e,{vertices:t})=>e+t.length,0),r=e=>new Float32Array(n*2*e),[i,a,o]=[r(3),r(3),r(4)],s=[],c=0;for(let{style:{width_px:e,dashed:n,faint:r},vertices:l}of t){let t=0;l.forEach((u,d)=>{let[f,p]=[l[d-1]??u,l[d+1]??u];t+=u.distanceTo(f);let m=p.clone().sub(f);for(let s of[-1,1])i.set([u.x,u.y,u.z+pp],c*3),a.set(m.toArray(),c*3),o.set([s*e,n,t,r],c*4),c+=1;d&&s.push(c-4,c-3,c-2,c-2,c-3,c-1)})}return new ma().setAttribute(`position`,new $i(i,3)).setAttribute(`ahead`,new $i(a,3)).setAttribute(`shape`,new $i(o,4)).setIndex(s)}var Sp=`
attribute vec3 ahead;
attribute vec4 shape;
uniform vec2 canvas;
varying vec2 vDash;
varying float vFaint;
void main() {
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  vec4 along = projectionMatrix * modelViewMatrix * vec4(ahead, 0.0);
  // Direction on the canvas: the derivative of xy / w. It is the same at both ends of a piece, also where one is behind the camera.
  vec2 direction = (along.xy * gl_Position.w - gl_Position.xy * along.w) * canvas;
  gl_Position.xy += vec2(-direction.y, direction.x) / max(length(direction), 1e-9) * shape.x / canvas * gl_Position.w;
  vDash = shape.yz;
  vFaint = shape.w;
}`,Cp=`
uniform vec3 colour;
uniform vec3 background;
varying vec2 vDash;
varying float vFaint;
void main() {
  if (vDash.x > 0.5 && mod(vDash.y, 6.0) > 3.0) discard;
  gl_FragColor = vec4(mix(colour, background, vFaint), 1.0);
  #include <colorspace_fragment>
}`;function wp(e,t,n,r){let[i,a,o]=[0,0,0];for(let s=0;s<=t;s++)for(let c=0;c<=t-s;c++){let t=n**s*r**c;i+=(e[0][o]??0)*t,a+=(e[1][o]??0)*t,o+=1}return[i,a]}function Tp(e,[t,n]){let[r,i]=[(t-e.centre_m[0])/e.radius_m,(n-e.centre_m[1])/e.radius_m];if(Math.abs(r)>1||Math.abs(i)>1)return null;let[a,o]=wp(e.to_degrees,e.degree,r,i);return[kp(e.lon_deg+a/e.unit_per_degree[0]),e.lat_deg+o/e.unit_per_degree[1]]}function Ep(e,[t,n]){let[r,i]=wp(e.to_metres,e.degree,kp(t-e.lon_deg)*e.unit_per_degree[0],(n-e.lat_deg)*e.unit_per_degree[1]);return[e.centre_m[0]+r*e.radius_m,e.centre_m[1]+i*e.radius_m]}var Dp=[`east`,`north-east`,`north`,`north-west`,`west`,`south-west`,`south`,`south-east`];function Op(e,[t,n]){let[r,i,a]=[5e4,``,``];for(let o of e.towns){let[e,s]=[t-o.xy_m[0],n-o.xy_m[1]],c=Math.hypot(e,s);c>=r||([r,i]=[c,o.label],a=Dp[(Math.round(Math.atan2(s,e)/(Math.PI/4))+8)%8]??``)}return r<5e3||!i?i:`${Math.round(r/1e3)} km ${a} of ${i}`}var kp=e=>((e+180)%360+360)%360-180;function Ap(e){let t=``,n=null,r=``;return{open(e){t=e,n=null,r=``},at([i,a]){if(n&&Math.max(Math.abs(i-n.centre_m[0]),Math.abs(a-n.centre_m[1]))<=n.radius_m/2)return n;let o=[i,a].map(e=>Math.round(e/1e4)*1e4),s=`${t} ${o.join(` `)}`;return t&&s!==r&&o.every(e=>Math.abs(e)<=5e6)&&(r=s,g.projection(t,o).then(t=>{s===r&&(n=t,e())},()=>void 0)),n&&Tp(n,[i,a])?n:null}}}var jp=8,Mp=64,Np=256,Pp=5,Fp=200,Ip=40075016.7;function Lp([e,t],n){let[r,i]=[2**n,Math.sin(t*Math.PI/180)];return[(e+180)/360*r,(.5-Math.log((1+i)/(1-i))/(4*Math.PI))*r]}function Rp([e,t],n){let r=2**n;return[e/r*360-180,Math.atan(Math.sinh(Math.PI*(1-2*t/r)))*180/Math.PI]}function zp(e,t,n,r){let i=new fi;e.scene.add(i);let a=_(`div`,{class:`attribution`,hidden:!0});t.append(a);let o=new Map,s=null,c=1,l=0,u=0;e.beforeDraw(()=>{if(i.visible=s!==null&&c>0,!i.visible||!s)return;u+=1;let{x:t,y:r}={x:e.pose()[0],y:e.pose()[1]},a=n.at([t,r]);a&&d(s,a)});function d(t,n){let r=Bp(e).map(e=>Tp(n,e)).filter(e=>e!==null),i=e.pixelsAtDepth(e.pose()[5]);if(r.length<3)return;let a=Ip*Math.cos(n.lat_deg*Math.PI/180),s=Math.min(Math.max(Math.floor(Math.log2(a*i/Fp)),0),t.max_zoom),c=Vp(r,s);for(;s>0&&(c.right-c.left+1)*(c.bottom-c.top+1)>Mp;)c=Vp(r,--s);let l=0,d=new Set;for(let e=c.top;e<=c.bottom;e++)for(let r=c.left;r<=c.right;r++){let i=`${s}/${r}/${e}`;d.add(i);let a=o.get(i)??f(t,n,i,s,r,e);a.usedAt=u,a.state===`loading`&&(l+=1)}for(let[e,t]of o)t.mesh.visible=t.state===`there`&&(d.has(e)||l>0&&t.usedAt>u-200);e.canvas.dataset.tiles=String(d.size-l),p()}function f(t,n,a,s,d,f){let p=new Aa({transparent:c<1,opacity:c,depthTest:!1,depthWrite:!1}),m=new Ha(Hp(n,s,d,f,e.ground),p);m.frustumCulled=!1,m.renderOrder=-100+s,m.visible=!1;let h={mesh:m,state:`loading`,zoom:s,usedAt:u};o.set(a,h),i.add(m);let g=new Image;return g.crossOrigin=`anonymous`,g.onload=()=>{if(!i.children.includes(m))return;let t=new Mr(g);t.colorSpace=Cn,t.generateMipmaps=!1,t.minFilter=1006,t.needsUpdate=!0,p.map=t,p.needsUpdate=!0,h.state=`there`,e.draw()},g.onerror=()=>{h.state=`missing`,l+=1,l===4&&![...o.values()].some(e=>e.state===`there`)&&r(`The base map cannot be loaded: ${new URL(g.src).host} does not answer, or does not allow other sites to use its tiles (CORS).`),e.draw()},g.src=t.template.replace(`{z}`,String(s)).replace(`{x}`,String(d)).replace(`{y}`,String(f)).replace(`{-y}`,String(2**s-1-f)),h}function p(){if(o.size<=Np)return;let e=[...o].filter(([,e])=>e.usedAt<u).sort((e,t)=>e[1].usedAt-t[1].usedAt);for(let[t,n]of e.slice(0,o.size-Np))m(t,n)}function m(e,{mesh:t}){i.remove(t),t.geometry.dispose(),t.material.map?.dispose(),t.material.dispose(),o.delete(e)}function h(){for(let[e,t]of o)m(e,t)}return{open(t){h(),l=0,s=t,a.textContent=t?.attribution??``,e.draw()},clear:h,apply(t){c=t;for(let{mesh:e}of o.values())e.material.transparent!==c<1&&(e.material.needsUpdate=!0),e.material.transparent=c<1,e.material.opacity=c;a.hidden=!a.textContent||c===0,e.draw()}}}function Bp(e){let[t,n,,,,r]=e.pose(),{clientWidth:i,clientHeight:a}=e.canvas,o=[];for(let[s,c]of[[0,0],[.5,0],[1,0],[1,.5],[1,1],[.5,1],[0,1],[0,.5]])for(let l=c;l<=1;l+=.125){let c=e.groundAt(s*i,l*a);if(!(!c||!e.plan&&Math.hypot(c[0]-t,c[1]-n)>Pp*r)){o.push([c[0],c[1]]);break}}return o}function Vp(e,t){let n=2**t-1,r=e=>Math.min(Math.max(Math.floor(e),0),n),i=e.map(e=>Lp(e,t)),[a,o]=[i.map(e=>e[0]),i.map(e=>e[1])];return{left:r(Math.min(...a)),right:r(Math.max(...a)),top:r(Math.min(...o)),bottom:r(Math.max(...o))}}function Hp(e,t,n,r,i){let[a,o,s]=[[],[],[]];for(let c=0;c<=jp;c++)for(let l=0;l<=jp;l++){let[u,d]=[l/jp,c/jp];a.push(...Ep(e,Rp([n+u,r+d],t)),i),o.push(u,1-d);let f=c*9+l;c<jp&&l<jp&&s.push(f,f+jp+1,f+1,f+1,f+jp+1,f+jp+2)}return new ma().setAttribute(`position`,new $i(new Float32Array(a),3)).setAttribute(`uv`,new $i(new Float32Array(o),2)).setIndex(s)}function Up(e,t){return t===null?e.at(-1):e.find(e=>e.changeset_no===t)??e.at(-1)}var Wp=e=>({id:e.feature_id,category:e.category,kind:`standing`,xyz:e.xyz_m,old:null,shift_m:null,height_m:e.object_height_m??0,probability:e.existence_probability,observations:e.observation_count,sigma_m:e.marking?.sigma_lateral_m??e.sigma_m,seenAt:Date.parse(e.last_seen_at),changeset:e.changeset_no,marking:e.marking??null,oldLine:null}),Gp=e=>{let t=e.kind===`moved`;return{...Wp(e),kind:e.kind,old:t?e.old_xyz_m:null,shift_m:e.shift_m,oldLine:t&&e.old_marking?.line_m||null}},Kp=({features:e,markings:t})=>[...e,...t].map(Wp),qp=({changes:e,markings:t})=>[...e,...t].map(Gp);function Jp(e,t){let{mode:n,changeset:r,from:i,to:a,known:o}=e;return(n===`drive`?[r]:n===`compare`?[i||null,a,o]:[o]).find(e=>e!==null&&!t.some(t=>t.changeset_no===e))??null}function Yp(e,t){let n=em(e,t);if(e.mode===`instant`)return{at:{valid:e.valid,known:n},since:null,title:`${e.valid===null?`latest state`:`at ${S(e.valid)} UTC`}, ${A(n)}`};if(e.mode===`compare`){let[r,i]=tm(e,t),a=e=>e===0?`before the first drive`:`after ${Up(t,e)?.drive_id??``}`;return{at:i,since:r.valid,title:`${a(e.to)}, compared with ${a(e.from)}, ${A(n)}`}}let r=Up(t,e.changeset),i=e.side===`before`;return{at:{valid:r?.valid_at??null,known:(i?r?.known_before:r?.effective_at)??null},since:null,title:`${i?`before`:`after`} ${r?`${r.drive_id} of ${S(r.captured_from,!1)} UTC`:``}, as known then`}}function Xp(e,t){let n=e.mode===`drive`?Up(t,e.changeset):void 0;if(e.mode===`instant`||e.mode===`drive`&&!n)return null;if(n)return{changeset_no:String(n.changeset_no)};let[r,i]=tm(e,t);return{from_valid_at:r.valid,from_known_at:r.known,to_valid_at:i.valid,to_known_at:i.known}}function Zp(e,t,n,r){let{cones:i}=t,a=Qp(t,n,r),o=e.filter(e=>!i.has(e.id)).map(e=>({...e,kind:a(e)}));return[...n.mode===`drive`&&n.side===`after`?[...i.values()].filter(e=>!se(e.kind)).map(e=>({...e,old:null,oldLine:null,shift_m:null})):i.values(),...o]}function Qp({withoutConfirmed:e,clusters:t,box:n},r,i){if(!n&&!t.length&&!e)return()=>`unchanged`;let a=r.mode===`drive`?``:tm(r,i)[0].valid??``,o=r.mode===`drive`?[Up(i,r.changeset)]:i.filter(e=>Date.parse(e.captured_from)>Date.parse(a)),s=new Set(o.map(e=>e?.changeset_no)),c=([e,t])=>!n||e>=n[0]&&t>=n[1]&&e<=n[2]&&t<=n[3],l=t.length?`standing`:e?`confirmed`:`unchanged`;return({changeset:e,xyz:t})=>s.has(e)?c(t)?l:`standing`:`unchanged`}function $p(e,t){let n=e.mode===`drive`?null:em(e,t);if(e.mode===`drive`){let r=Up(t,e.changeset)?.captured_from,[i,a]=[r===void 0?1/0:Date.parse(r),e.side===`before`];return{reached:e=>a?Date.parse(e.captured_from)<i:Date.parse(e.captured_from)<=i,known:n}}let r=e.mode===`instant`?e.valid:nm(t,e.to,n).valid,i=r===null?1/0:Date.parse(r);return{reached:e=>Date.parse(e.changed_at)<=i,known:n}}function em(e,t){return e.known===null?null:Up(t,e.known)?.committed_at??null}function tm(e,t){let n=em(e,t);return[nm(t,e.from,n),nm(t,e.to,n)]}function nm(e,t,n){let r=e[0];return t===0&&r?{valid:new Date(Date.parse(r.captured_from)-1e3).toISOString(),known:n}:{valid:Up(e,t)?.valid_at??null,known:n}}function rm(e,t){if(!e.trajectory)return[];let n=(...e)=>e.filter(e=>e!==void 0);if(e.mode===`drive`)return n(Up(t,e.changeset));if(e.mode===`compare`)return n(e.from===0?void 0:Up(t,e.from),Up(t,e.to));let r=e.valid===null?1/0:Date.parse(e.valid);return t.filter(e=>Date.parse(e.captured_from)<=r).slice(-10)}var im=2**20,am=20,om=2e3,sm=16,cm=96,lm=2,um=300;function dm(e,t){let n=Bp(e);return n.length<3?[]:n.flatMap(([e,n])=>[(e+t[0]).toFixed(2),(n+t[1]).toFixed(2)])}function fm(e){let t=Bp(e),[n,r]=[t.map(e=>e[0]),t.map(e=>e[1])],[i,a,o,s]=t.length?[Math.min(...n),Math.min(...r),Math.max(...n),Math.max(...r)]:[0,0,0,0],c=2**Math.ceil(Math.log2(Math.max(o-i,s-a,1)))/4;return[Math.floor(i/c-1)*c,Math.floor(a/c-1)*c,Math.ceil(o/c+1)*c,Math.ceil(s/c+1)*c]}function pm(e){return Math.min(Math.max(Math.round(Math.log2(sm*im/(e?e[2]-e[0]:im))),0),30)}function mm(e){let[t,n]=[``,{valid:null,known:null}],r=null,i=new Map,a=0,o=0,s={cones:[],clusters:[]},c=()=>Object.values(r?.categories??{}).reduce((e,t)=>e+t,0),l=(e,t)=>e[0]<=t[2]&&e[2]>=t[0]&&e[1]<=t[3]&&e[3]>=t[1];function u(e,r,a,o){let s=`${e}/${r}/${a}`,c=i.get(s);if(c)return c;let l=im/2**e,[u,d]=[r*l-o[0],a*l-o[1]],f={zoom:e,x:r,y:a,box:[u,d,u+l,d+l],cones:[],clusters:[],answer:Promise.resolve()};return f.answer=g.tile(t,s,n).then(e=>void([f.cones,f.clusters]=[Kp(e),e.clusters])),i.set(s,f),f}function d(e,t,n=Math.floor(Math.log2(lm*im/Math.max(e[2]-e[0],e[3]-e[1],1)))){let r=Math.min(Math.max(n,0),am),i=(e,n)=>Math.floor((e+t[n])*2**r/im),a=[];for(let n=i(e[0],0);n<=i(e[2],0);n++)for(let o=i(e[1],1);o<=i(e[3],1);o++)a.push(u(r,n,o,t));return a}function f({box_m:t}){let n=Bp(e);if(!t||n.length<3)return null;let[r,i]=[n.map(e=>e[0]),n.map(e=>e[1])],a=[Math.max(Math.min(...r),t[0]),Math.max(Math.min(...i),t[1]),Math.min(Math.max(...r),t[2]),Math.min(Math.max(...i),t[3])];return a[0]<=a[2]&&a[1]<=a[3]?a:null}function p({zoom:t,box:n}){if(t>=am)return!1;let{x:r,y:i,z:a}=e.camera.position,o=Math.hypot(Math.max(n[0]-r,r-n[2],0),Math.max(n[1]-i,i-n[3],0),a-e.ground);return(n[2]-n[0])/sm*e.pixelsAtDepth(o)>cm}async function m(e,t,n){if(await e.answer,!e.clusters.length||!p(e))return[e];let r=[0,1].flatMap(t=>[0,1].map(n=>[2*e.x+t,2*e.y+n])),i=(e.box[2]-e.box[0])/2,a=r.filter(([e,r])=>{let[a,o]=[e*i-n[0],r*i-n[1]];return l([a,o,a+i,o+i],t)});return(await Promise.all(a.map(([r,i])=>m(u(e.zoom+1,r,i,n),t,n)))).flat()}return{async open(e,o){let s=++a,c=await g.summary(e,o);return s===a&&([t,n,r,i]=[e,o,c,new Map]),c},async load(){let e=++o,t=r,n=c()<=om,a=t&&(n?t.box_m:f(t)),l=t?.origin_m??[0,0,0],u=t&&a?await Promise.all(d(a,l,n?0:void 0).map(e=>m(e,a,l))):[];if(e!==o)return!1;let p=u.flat(),[h,g,_]=[s,p.flatMap(e=>e.cones),p.flatMap(e=>e.clusters)];s={cones:g,clusters:_};for(let e of[...i.keys()].slice(0,Math.max(i.size-um,0)))i.delete(e);return h.cones.length!==g.length||h.clusters.length!==_.length||g.some((e,t)=>e!==h.cones[t])||_.some((e,t)=>e!==h.clusters[t])},async overview(){let e=r?.box_m;if(!r||!e)return[];let t=d(e,r.origin_m);return await Promise.all(t.map(e=>e.answer)),t.flatMap(e=>[...e.cones.map(e=>e.xyz),...e.clusters.map(e=>e.xyz_m)])},shown:()=>s,isWhole:()=>c()<=om,summary:()=>r,count:c,close(){a+=1,o+=1,[r,i,s]=[null,new Map,{cones:[],clusters:[]}]}}}var hm=2e3,gm={cones:new Map,withoutConfirmed:!1,clusters:[],box:null};function _m(e){let t=``,n=[0,0,0],r=null,i=new Map,a=gm,[o,s]=[0,0],c=null,l=()=>[...i.values()].reduce((e,t)=>e+t,0);return{async open(e,a,s){let l=++o,u=s?(await g.changeSummary(e,s)).kinds:{};l===o&&([t,n,r,c]=[e,a,s,null],i=new Map(Object.entries(u)))},async load(){let i=++s,o=l()>hm?fm(e):null,u=String(o);if(u===c)return!1;let d=o&&[0,1,2,1,2,3,0,3].map((e,t)=>String(o[e]+n[t%2==0?0:1])),f=r&&l()?await g.changesInView(t,{...r,area:d,cell_zoom:String(pm(o))}):null;return i===s&&(c=u,a=f?{cones:new Map(qp(f).map(e=>[e.id,e])),withoutConfirmed:`confirmed`in f.kinds&&!f.listed.includes(`confirmed`),clusters:f.clusters,box:o}:gm,!0)},shown:()=>a,isOpen:()=>r!==null,kinds:()=>i,standing:()=>[...i].reduce((e,[t,n])=>e+(se(t)?0:n),0),close(){o+=1,s+=1,[r,i,a,c]=[null,new Map,gm,null]}}}var vm=42,ym=new Intl.NumberFormat(`en`,{notation:`compact`,maximumFractionDigits:1});function bm(e,t,n=``,r=``){let i=_(`div`,{class:`clusters ${n}`,aria:{hidden:`true`}});t.append(i);let a=[],o=[],s=[];function c(){o=[];let{clientWidth:t,clientHeight:n}=e.canvas;for(let{at:r,count:i}of a){let a=e.project(r);if(!a||Math.min(a[0],a[1])<-42||a[0]>t+vm||a[1]>n+vm)continue;let s=o.find(e=>Math.hypot(e.pixel[0]-a[0],e.pixel[1]-a[1])<vm);s?s.count+=i:o.push({at:r,count:i,pixel:a})}for(;s.length<o.length;)s.push(i.appendChild(_(`span`,{class:`cluster`})));for(let[e,t]of s.entries()){let n=o[e];t.hidden=!n,n&&(t.textContent=r+ym.format(n.count),t.style.setProperty(`--size`,`${Math.round(18+5*Math.log10(n.count))}px`),t.style.transform=`translate(${Math.round(n.pixel[0])}px, ${Math.round(n.pixel[1])}px)`)}}return e.beforeDraw(()=>void((a.length||o.length)&&c())),{show(t){a=t.filter(({count:e})=>e>0).map(({xyz_m:e,count:t})=>({at:e,count:t})),e.draw()},pick:(e,t)=>o.find(({pixel:n})=>Math.hypot(n[0]-e,n[1]-t)<vm/2)?.at??null}}function xm(e,t=!1){let n=e[0].index!==null,r=new Set(Object.keys(e[0].attributes)),i=new Set(Object.keys(e[0].morphAttributes)),a={},o={},s=e[0].morphTargetsRelative,c=new ma;c.morphTargetsRelative=s;let l=0;for(let u=0;u<e.length;++u){let d=e[u],f=0,p=0;if(n!==(d.index!==null))return console.error(`THREE.BufferGeometryUtils: .mergeGeometries() failed with geometry at index `+u+`. All geometries must have compatible attributes; make sure index attribute exists among all geometries, or in none of them.`),null;for(let e in d.attributes){if(!r.has(e))return console.error(`THREE.BufferGeometryUtils: .mergeGeometries() failed with geometry at index `+u+`. All geometries must have compatible attributes; make sure "`+e+`" attribute exists among all geometries, or in none of them.`),null;a[e]===void 0&&(a[e]=[]),a[e].push(d.attributes[e]),f++}if(f!==r.size)return console.error(`THREE.BufferGeometryUtils: .mergeGeometries() failed with geometry at index `+u+`. Make sure all geometries have the same number of attributes.`),null;if(s!==d.morphTargetsRelative)return console.error(`THREE.BufferGeometryUtils: .mergeGeometries() failed with geometry at index `+u+`. .morphTargetsRelative must be consistent throughout all geometries.`),null;for(let t in d.morphAttributes){if(!i.has(t))return console.error(`THREE.BufferGeometryUtils: .mergeGeometries() failed with geometry at index `+u+`.  .morphAttributes must be consistent throughout all geometries.`),null;if(d.morphAttributes[t].length!==e[0].morphAttributes[t].length)return console.error(`THREE.BufferGeometryUtils: .mergeGeometries() failed with geometry at index `+u+`. All geometries must have the same number of morph targets for the "`+t+`" morph attribute.`),null;o[t]===void 0&&(o[t]=[]),o[t].push(d.morphAttributes[t]),p++}if(p!==i.size)return console.error(`THREE.BufferGeometryUtils: .mergeGeometries() failed with geometry at index `+u+`. Make sure all geometries have the same number of morph attributes.`),null;if(t){let e;if(n)e=d.index.count;else if(d.attributes.position!==void 0)e=d.attributes.position.count;else return console.error(`THREE.BufferGeometryUtils: .mergeGeometries() failed with geometry at index `+u+`. The geometry must have either an index or a position attribute`),null;c.addGroup(l,e,u),l+=e}}if(n){let t=0,n=[];for(let r=0;r<e.length;++r){let i=e[r].index;for(let e=0;e<i.count;++e)n.push(i.getX(e)+t);t+=e[r].attributes.position.count}c.setIndex(n)}for(let e in a){let t=Sm(a[e]);if(!t)return console.error(`THREE.BufferGeometryUtils: .mergeGeometries() failed while trying to merge the `+e+` attribute.`),null;c.setAttribute(e,t)}for(let e in o){let t=o[e][0].length;if(t!==0){c.morphAttributes=c.morphAttributes||{},c.morphAttributes[e]=[];for(let n=0;n<t;++n){let t=[];for(let r=0;r<o[e].length;++r)t.push(o[e][r][n]);let r=Sm(t);if(!r)return console.error(`THREE.BufferGeometryUtils: .mergeGeometries() failed while trying to merge the `+e+` morphAttribute.`),null;c.morphAttributes[e].push(r)}}}return c}function Sm(e){let t,n,r,i=-1,a=0;for(let o=0;o<e.length;++o){let s=e[o];if(t===void 0&&(t=s.array.constructor),t!==s.array.constructor)return console.error(`THREE.BufferGeometryUtils: .mergeAttributes() failed. BufferAttribute.array must be of consistent array types across matching attributes.`),null;if(n===void 0&&(n=s.itemSize),n!==s.itemSize)return console.error(`THREE.BufferGeometryUtils: .mergeAttributes() failed. BufferAttribute.itemSize must be consistent across matching attributes.`),null;if(r===void 0&&(r=s.normalized),r!==s.normalized)return console.error(`THREE.BufferGeometryUtils: .mergeAttributes() failed. BufferAttribute.normalized must be consistent across matching attributes.`),null;if(i===-1&&(i=s.gpuType),i!==s.gpuType)return console.error(`THREE.BufferGeometryUtils: .mergeAttributes() failed. BufferAttribute.gpuType must be consistent across matching attributes.`),null;a+=s.count*n}let o=new t(a),s=new $i(o,n,r),c=0;for(let t=0;t<e.length;++t){let r=e[t];if(r.isInterleavedBufferAttribute){let e=c/n;for(let t=0,i=r.count;t<i;t++)for(let i=0;i<n;i++){let n=r.getComponent(t,i);s.setComponent(t+e,i,n)}}else o.set(r.array,c);c+=r.count*n}return i!==void 0&&(s.gpuType=i),s}var Cm=9,wm={white:`#ffffff`,yellow:`#f2b705`,other:`#9aa5b0`},Tm=.02,[Em,Dm,Om]=[1,1.8,1],km={dash_m:.7,gap_m:.7},Am=.6,jm=e=>e===`standing`||e===`confirmed`||e===`unchanged`,Mm=({dash_m:e,gap_m:t})=>`dashed, ${e?.toFixed(1)} m with gaps of ${t?.toFixed(1)} m`,Nm=e=>`${e.colour}, ${e.dash_m===null?`solid`:Mm(e)}`;function Pm(e){return e.reduce((t,n,r)=>t+(r?Math.hypot(n[0]-e[r-1][0],n[1]-e[r-1][1],n[2]-e[r-1][2]):0),0)}function Fm(e,t){let[n,r]=[e[Math.max(t-1,0)],e[Math.min(t+1,e.length-1)]],i=Math.hypot(r[0]-n[0],r[1]-n[1])||1;return[-(r[1]-n[1])/i,(r[0]-n[0])/i]}function Im(e){let t=new fi,n=Vm(),r=new Ha(new ma,n);r.frustumCulled=!1,r.renderOrder=-.5,t.add(r);let i=[],a=new Rr;function o(e){i=e,r.geometry.dispose(),r.geometry=Bm(Rm(i)),r.visible=i.length>0}function s(t,n){let r=a.multiplyMatrices(e.camera.projectionMatrix,e.camera.matrixWorldInverse).elements,o=(e,[t,n,i])=>r[e]*t+r[e+4]*n+r[e+8]*i+r[e+12],{clientWidth:s,clientHeight:c}=e.canvas,[l,u]=[null,Cm];for(let e of i){let r=null;for(let i of e.marking?.line_m??[]){let a=o(3,i),d=a>0?[(o(0,i)/a+1)/2*s,(1-o(1,i)/a)/2*c]:null,f=d&&r?Lm(t,n,...r,...d):1/0;f<u&&([l,u]=[e,f]),r=d}}return l}return{group:t,show:o,pick:s}}function Lm(e,t,n,r,i,a){let o=i-n,s=a-r,c=o*o+s*s,l=c?Math.max(0,Math.min(1,((e-n)*o+(t-r)*s)/c)):0;return Math.hypot(e-n-l*o,t-r-l*s)}function Rm(e){let t=zm(e);return e.flatMap(({id:e,kind:n,marking:r,oldLine:i})=>{if(!r)return[];let a=r.width_m/2,o=se(n),{dash_m:s,gap_m:c}=o?km:r,l={dash_m:s??0,period_m:(s??0)+(c??0),start_m:o?0:t.get(e)??0},u={line:r.line_m,half_m:a,colour:jm(n)?wm[r.colour]:op(n),least_px:jm(n)?Em:Dm,...l};return[...n===`moved`&&i?[{...u,line:i,dash_m:km.dash_m,period_m:km.dash_m+km.gap_m,start_m:0}]:[],u]})}function zm(e){let t=e.filter(e=>e.marking?.dash_m&&!se(e.kind)),n=([e,t],n=0,r=0)=>`${Math.floor(e/Am)+n} ${Math.floor(t/Am)+r}`,r=new Map;for(let e of t){let t=n(e.marking.line_m.at(-1));r.set(t,[...r.get(t)??[],e])}let i=[-1,0,1].flatMap(e=>[-1,0,1].map(t=>[e,t])),a=e=>{let t=e.marking.line_m[0];return i.flatMap(([e,i])=>r.get(n(t,e,i))??[]).find(n=>n!==e&&Math.hypot(...[0,1].map(e=>n.marking.line_m.at(-1)[e]-t[e]))<Am)},o=new Map;for(let e of t){let t=[],n=new Set;for(let r=e;r&&!o.has(r.id)&&!n.has(r.id);r=a(r))t.push(r),n.add(r.id);let r=t.length?a(t.at(-1)):void 0;for(let e of t.reverse())o.set(e.id,r&&o.has(r.id)?o.get(r.id)+Pm(r.marking.line_m):0),r=e}return o}function Bm(e){let t=e.reduce((e,t)=>e+t.line.length,0),n=e=>new Float32Array(t*2*e),[r,i,a,o,s]=[n(3),n(3),n(1),n(3),n(4)],c=[],l=new Y,u=0;for(let{line:t,half_m:n,colour:d,least_px:f,dash_m:p,period_m:m,start_m:h}of e){let e=l.set(d).toArray(),g=h;t.forEach(([l,d,h],_)=>{let v=Fm(t,_);_&&(g+=Math.hypot(l-t[_-1][0],d-t[_-1][1],h-t[_-1][2]));for(let t of[-1,1])r.set([l,d,h+Tm],u*3),i.set([...v,t],u*3),a[u]=g,o.set(e,u*3),s.set([n,f,p,m],u*4),u+=1;_&&c.push(u-4,u-3,u-2,u-2,u-3,u-1)})}return new ma().setAttribute(`position`,new $i(r,3)).setAttribute(`across`,new $i(i,3)).setAttribute(`along`,new $i(a,1)).setAttribute(`tint`,new $i(o,3)).setAttribute(`shape`,new $i(s,4)).setIndex(c)}function Vm(){let e=new uc({vertexShader:Hm,fragmentShader:Um,side:2,uniforms:{perMetre:{value:1},rimPx:{value:Om},rim:{value:new Y}}});return e.onBeforeRender=(t,n,r)=>{let i=r.projectionMatrix.elements[5]??1;e.uniforms.perMetre.value=t.domElement.clientHeight*i/2,e.uniforms.rim.value.set(ip().rim),e.uniformsNeedUpdate=!0},e}var Hm=`
attribute vec3 across;
attribute float along;
attribute vec3 tint;
attribute vec4 shape;
uniform float perMetre;
uniform float rimPx;
varying vec3 vTint;
varying float vAcross;
varying float vAlong;
varying vec2 vDash;
void main() {
  vec4 middle = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  float pixel_m = max(middle.w, 0.01) / perMetre;
  float paint = max(shape.x, shape.y * pixel_m);
  float whole = paint + rimPx * pixel_m;
  vTint = tint;
  vAcross = across.z * whole / paint;
  vAlong = along;
  vDash = shape.zw;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position + vec3(across.xy, 0.0) * across.z * whole, 1.0);
}`,Um=`
uniform vec3 rim;
varying vec3 vTint;
varying float vAcross;
varying float vAlong;
varying vec2 vDash;
void main() {
  // Dashes of less than three pixels would flicker: the line is drawn without its gaps.
  if (vDash.y > 0.0 && mod(vAlong, vDash.y) > vDash.x && 3.0 * fwidth(vAlong) < vDash.y) discard;
  float soft = 0.5 * fwidth(vAcross);
  gl_FragColor = vec4(mix(vTint, rim, smoothstep(1.0 - soft, 1.0 + soft, abs(vAcross))), 1.0);
  #include <colorspace_fragment>
}`,Wm=18,Gm=e=>e.quality.plain?12:4,Km=13,qm=e=>e.plan?0:B()?Km:1.4*Km;function Jm(e){let t=Im(e),n=mh(1),r=new fi;e.scene.add(r);let i=Sh(e),a=[],o=new Rr,s=Ym(n),c=Ym(mh(1,.65)),l=Ym(mh(.35)),u=mh(1,1),d=Ym(u),f=Xm(n),p=new Ha(new ma,n);p.frustumCulled=!1,p.visible=!1,r.add(s.holder,c.holder,l.holder,d.holder,f.mesh,p,i.group,t.group),e.beforeDraw(()=>[s,c,l,d,f].forEach(t=>t.cull(e)));function m(n){a=n.filter(e=>!e.marking),t.show(n.filter(e=>e.marking));let r=e=>op(e.kind),o=(e,t)=>({category:e.category,at:t,height:e.height_m}),m=a.filter(e=>!se(e.kind)),h=ap();u.uniforms.tone.value.set(h??`white`),d.set(m.filter(e=>h&&e.kind===`added`).map(e=>o(e,e.xyz))),s.set(m.filter(e=>e.kind!==`unchanged`&&!(h&&e.kind===`added`)).map(e=>o(e,e.xyz))),c.set(m.filter(e=>e.kind===`unchanged`).map(e=>o(e,e.xyz))),l.set(a.flatMap(e=>{let t=se(e.kind)?e.xyz:e.kind===`moved`?e.old:null;return t?[o(e,t)]:[]})),f.set(a.filter(e=>!jm(e.kind)).map(e=>({at:e.xyz,height:e.height_m,colour:r(e)})));let g=a.flatMap(e=>e.kind===`moved`&&e.old?_h(e.old,e.xyz,.32*e.height_m,r(e)):[]);p.geometry.dispose(),p.geometry=g.length?xm(g):new ma,p.visible=g.length>0,i.set(a),e.draw()}function h(n,r){let i=null,s=1,c=o.multiplyMatrices(e.camera.projectionMatrix,e.camera.matrixWorldInverse).elements,l=(e,t,n,r)=>c[e]*t+c[e+4]*n+c[e+8]*r+c[e+12],{clientWidth:u,clientHeight:d}=e.canvas;for(let t of a){let[a,o,c]=t.xyz,f=c+t.height_m,p=l(3,a,o,c),m=l(3,a,o,f);if(p<=0||m<=0||l(2,a,o,c)>p)continue;let h=(l(0,a,o,c)/p+1)/2*u,g=(1-l(1,a,o,c)/p)/2*d,_=(l(0,a,o,f)/m+1)/2*u,v=(1-l(1,a,o,f)/m)/2*d,y=Math.max(Wm,Math.hypot(_-h,v-g)*.35),b=Lm(n,r,h,g,_,v-qm(e))/y;b<s&&(s=b,i=t)}return i??t.pick(n,r)}return{show:m,pick:h,setVisible:e=>void(r.visible=e)}}function Ym(e){let t=new Rr,n=new q,r=new fi,i=[];function a(t){for(let{mesh:e}of i)e.dispose();let n=B()?[]:[...new Set(t.map(e=>e.category))].filter(e=>e!==fe),a=e=>[e,n.length?t.filter(t=>t.category===e):t];i=[fe,...n].map(a).map(([t,n])=>({items:n,mesh:Zm(fh(t),e,n.length),turned:t!==fe})),r.clear().add(...i.map(e=>e.mesh))}return a([]),{holder:r,set:a,cull(e){let[r,a]=[e.pose()[3],Gm(e)];for(let{items:o,mesh:s,turned:c}of i){let i=0;for(let{at:l,height:u}of o)e.sees(l,u,a)&&(c?t.makeRotationZ(r).scale(n.setScalar(u)):t.makeScale(u,u,u),s.setMatrixAt(i,t.setPosition(...l)),i+=1);Qm(s,i)}}}}function Xm(e){let t=new Rr,n=new Y,r=new $s(.62,.85,24).translate(0,0,.03),i={mesh:new fi,set:s,cull:c},a=[],o=Zm(ph(r,new Y(`white`)),e,0);function s(t){a=t,o.dispose(),o=Zm(r,e,a.length),o.setColorAt(0,n),i.mesh.clear().add(o)}function c(e){let r=Gm(e),i=0;for(let{at:s,height:c,colour:l}of a)e.sees(s,c,r)&&(o.setMatrixAt(i,t.makeScale(c,c,1).setPosition(...s)),o.setColorAt(i,n.set(l)),i+=1);Qm(o,i),o.instanceColor&&(o.instanceColor.needsUpdate=!0)}return s([]),i}function Zm(e,t,n){let r=new eo(e,t,Math.max(n,1));return r.frustumCulled=!1,r.count=0,r}function Qm(e,t){e.count=t,e.visible=t>0,e.instanceMatrix.needsUpdate=!0}var[$m,eh,th,nh,rh,ih,ah]=[`#ff6a13`,`#c8102e`,`#f7f7f2`,`#ffc20e`,`#2b2b2b`,`#6d7479`,`#9aa3ab`];function oh(e,t,n,r,i,a=0){return[new Po(e,t,r-n).translate(a,0,(n+r)/2),i]}function sh(e,t,n,r,i){return[new Io(t,e,r-n,20,1,!1).rotateX(Math.PI/2).translate(0,0,(n+r)/2),i]}var ch=(e,t,n)=>[new Po(e*Math.SQRT1_2,t,e*Math.SQRT1_2).rotateY(Math.PI/4).translate(0,0,.5),n],lh=(e,t,n)=>[new Io(e/2,e/2,t,32).translate(0,0,.5),n],uh=new Map(Object.entries({traffic_cone:()=>{let e=e=>.2-.165*e,t=(t,n,r)=>sh(e(t),e(n),t,n,r);return[oh(.56,.56,0,.05,rh),t(.05,.36,$m),t(.36,.54,th),t(.54,.66,$m),t(.66,.84,th),t(.84,1,$m)]},tubular_marker:()=>[sh(.16,.13,0,.06,rh),sh(.055,.055,.06,.55,$m),sh(.055,.055,.55,.68,th),sh(.055,.055,.68,.78,$m),sh(.055,.055,.78,.91,th),sh(.055,.05,.91,1,$m)],drum:()=>[sh(.33,.32,0,.07,rh),sh(.28,.275,.07,.3,$m),sh(.275,.265,.3,.47,th),sh(.265,.26,.47,.64,$m),sh(.26,.25,.64,.81,th),sh(.25,.22,.81,1,$m)],vertical_panel:()=>[oh(.42,.3,0,.06,rh),oh(.06,.03,.06,.2,ih),oh(.3,.03,.2,1,eh),oh(.3,.035,.36,.52,th),oh(.3,.035,.68,.84,th)],barricade:()=>[-.45,.45].flatMap(e=>[oh(.06,.5,0,.06,ih,e),oh(.06,.06,.06,.75,ih,e)]).concat([.75,.4].flatMap(e=>[oh(1.2,.05,e,e+.25,eh),oh(.24,.055,e,e+.25,th,-.3),oh(.24,.055,e,e+.25,th,.3)])),work_zone_sign:()=>[ch(1,.03,rh),ch(.9,.035,$m)],arrow_board:()=>[oh(.5,.3,.05,.16,ih),oh(.06,.06,.16,.45,ih),oh(1.2,.06,.45,1,rh),oh(.7,.065,.7,.76,nh),[new Po(.2,.065,.2).rotateY(Math.PI/4).translate(.3,0,.73),nh]],traffic_sign:()=>[lh(1,.03,eh),lh(.76,.035,th)]})),dh=new Map;function fh(e){let t=dh.get(e)??xm((uh.get(e)?.()??[oh(.4,.4,0,1,ah)]).map(([e,t])=>ph(e,new Y(t))));return dh.set(e,t),t}function ph(e,{r:t,g:n,b:r}){let i=new Float32Array(e.getAttribute(`position`).count*3);for(let e=0;e<i.length;e+=3)i.set([t,n,r],e);return e.setAttribute(`color`,new $i(i,3))}function mh(e,t=0){return new uc({vertexShader:hh,fragmentShader:gh,vertexColors:!0,uniforms:{opacity:{value:e},grey:{value:t},tone:{value:new Y(.55,.55,.55)}},transparent:e<1,depthWrite:e===1})}var hh=`
uniform float grey;
uniform vec3 tone;
varying vec3 vTint;
void main() {
  vec4 at = vec4(position, 1.0);
  vec3 n = normal;
  vTint = color;
#ifdef USE_INSTANCING
  at = instanceMatrix * at;
  n = mat3(instanceMatrix) * n;
#endif
#ifdef USE_INSTANCING_COLOR
  vTint *= instanceColor;
#endif
  vTint = mix(vTint, tone, grey);
  vTint *= 0.6 + 0.51 * max(dot(normalize(n), vec3(-0.296, -0.474, 0.829)), 0.0);
  gl_Position = projectionMatrix * modelViewMatrix * at;
}`,gh=`
uniform float opacity;
varying vec3 vTint;
void main() {
  gl_FragColor = vec4(vTint, opacity);
  #include <colorspace_fragment>
}`;function _h(e,t,n,r){let[i,a]=[new q(...e),new q(...t)],o=a.clone().sub(i),s=Math.max(o.length()-n,.05),c=Math.min(.35,s*.35),l=new Io(.035,.035,Math.max(s-c,.01),8).translate(0,(s-c)/2,0),u=new Lo(.12,c,12).translate(0,s-c/2,0),d=new hr().setFromUnitVectors(new q(0,1,0),o.normalize());return[l,u].map(e=>ph(e.applyQuaternion(d).translate(i.x,i.y,i.z+.08),new Y(r)))}var vh=`
attribute vec3 tint;
attribute float shape;
uniform float size;
uniform float lift;
varying vec3 vTint;
varying float vShape;
void main() {
  vTint = tint;
  vShape = shape;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
  gl_Position.y += lift * gl_Position.w;
  gl_PointSize = shape < 0.5 ? size * 0.72 : size;
}`,yh=`
uniform vec3 halo;
varying vec3 vTint;
varying float vShape;
float bar(vec2 p) { return min(max(abs(p.x) - 0.15, abs(p.y) - 0.62), max(abs(p.y) - 0.15, abs(p.x) - 0.62)); }
/** A slim body on a plate. */
float cone(vec2 p) { return min(max(abs(p.x) - 0.24 - 0.22 * p.y, abs(p.y + 0.1) - 0.55), max(abs(p.x) - 0.55, abs(p.y - 0.5) - 0.12)); }
/** Tip up; gl_PointCoord grows downwards. */
float triangle(vec2 p) { return max(p.y - 0.5, abs(p.x) * 0.88 - p.y * 0.47 - 0.36); }
void main() {
  vec2 p = gl_PointCoord * 2.0 - 1.0;
  float d = length(p) - 0.55;
  float w = max(abs(p.x), abs(p.y));
  if (vShape > 7.5) d = cone(p);
  else if (vShape > 6.5) d = triangle(vec2(p.x, -p.y));
  else if (vShape > 5.5) d = triangle(p);
  else if (vShape > 4.5) d = w - 0.52;
  else if (vShape > 3.5) d = abs(length(p) - 0.47) - 0.17;
  else if (vShape > 2.5) d = bar(mat2(0.7071, 0.7071, -0.7071, 0.7071) * p);
  else if (vShape > 1.5) d = (abs(p.x) + abs(p.y)) - 0.72;
  else if (vShape > 0.5) d = bar(p);
  if (d > 0.2) discard;
  gl_FragColor = vec4(d > 0.02 ? halo : vTint, 1.0);
  #include <colorspace_fragment>
}`;function bh(){let e=document.createElement(`canvas`);[e.width,e.height]=[64*ge.length,64];let t=e.getContext(`2d`);return ge.forEach((e,n)=>{if(t){t.setTransform(64/18,0,0,64/18,(n+1/18)*64,64/18),t.lineJoin=`round`;for(let[n,r]of[[2,0],[1,255]])[t.lineWidth,t.strokeStyle]=[n,`rgb(${r} 0 0)`],t.stroke(new Path2D(e));t.fillStyle=`rgb(130 0 0)`,t.fill(new Path2D(e))}}),new Ao(e)}var xh=`
uniform vec3 halo;
uniform sampler2D glyphs;
varying vec3 vTint;
varying float vShape;
void main() {
  vec4 texel = texture2D(glyphs, vec2((vShape + gl_PointCoord.x) / ${ge.length.toFixed(1)}, 1.0 - gl_PointCoord.y));
  if (texel.a < 0.5) discard;
  gl_FragColor = vec4(mix(halo, vTint, texel.r), 1.0);
  #include <colorspace_fragment>
}`;function Sh(e){let t=new fi,n=Ch(e,t,5,17,yh),r=null;function i(i){let a=[...i].sort((e,t)=>L[e.kind].shape-L[t.kind].shape);n(a.filter(e=>e.kind!==`standing`||e.category===`traffic_cone`),e=>L[e.kind].shape);let o=B()?[]:a.filter(e=>e.category!==fe);o.length&&(r??=Ch(e,t,4,30,xh,bh())),r?.(o,e=>ve(e.category))}return i([]),{group:t,set:i}}function Ch(e,t,n,r,i,a=null){let o=new uc({vertexShader:vh,fragmentShader:i,uniforms:{size:{value:r},lift:{value:0},halo:{value:new Y},glyphs:{value:a}},depthTest:!1,transparent:!0}),s=new Do(new ma,o);t.add(s),s.frustumCulled=!1,s.renderOrder=n,s.onBeforeRender=t=>{let n=t.getPixelRatio();o.uniforms.size.value=r*n,o.uniforms.halo.value.set(ip().halo),o.uniforms.lift.value=2*qm(e)/Math.max(t.domElement.clientHeight,1),o.uniformsNeedUpdate=!0};let c=new Y;return(e,t)=>{let[n,r,i]=[new Float32Array(e.length*3),new Float32Array(e.length*3),new Float32Array(e.length)];e.forEach((e,a)=>{n.set([e.xyz[0],e.xyz[1],e.xyz[2]+e.height_m],a*3),r.set(c.set(op(e.kind)).toArray(),a*3),i[a]=t(e)}),s.geometry.dispose(),s.geometry=new ma().setAttribute(`position`,new $i(n,3).setUsage(kn)).setAttribute(`tint`,new $i(r,3)).setAttribute(`shape`,new $i(i,1)),s.visible=e.length>0}}var wh=`conetl writer token`,Th=`conetl name`,Eh=null,Dh={logIn:e=>void(Eh=e),person:()=>Eh,name:()=>Eh??sessionStorage.getItem(Th)??``,token:()=>Eh===null?sessionStorage.getItem(wh):``,keep(e,t){sessionStorage.setItem(Th,e),sessionStorage.setItem(wh,t)},forget:()=>sessionStorage.removeItem(wh)};function Oh(e,t,n,r){return e.filter(e=>e.changeset_id===null?e.feature_id===t||n!==void 0&&e.of_line===r&&e.xy_m!==null&&Math.hypot(e.xy_m[0]-n[0],e.xy_m[1]-n[1])<=(e.radius_m??0):!1)}var kh=(e,t,n,r)=>({text:e===`suppress`?`Suppress …`:`Pin …`,explain:e===`suppress`?`Removes this ${r} from the map and keeps its history. Later drives do not add one here again.`:`Keeps this ${r} on the map at this position. Later drives can confirm it, but not move or remove it.`,submit:`${e===`suppress`?`Suppress`:`Pin`} this ${r}`,withRadius:!0,request:r=>({kind:e,feature_id:t,expected_version:n,...r}),done:e===`suppress`?`Suppressed.`:`Pinned.`}),Ah={suppress:[`Withdraw …`,`Withdraw the decision`,`Drives update this position again.`],classify:[`Withdraw …`,`Withdraw the decision`,`The detector decides the class again.`],approve:[`Withdraw …`,`Withdraw the approval`,`The change waits for review again.`],pin:[`Unpin …`,`Unpin`,`Drives update this position again.`],revert:[`Withdraw …`,`Withdraw the decision`,`The drive is merged into the map again.`],accept:[`Withdraw …`,`Withdraw the decision`,`The drive goes on hold again if its health checks still fail.`],hold:[`Accept …`,`Accept the drive`,`The drive is merged into the map although a health check failed.`]},jh=e=>({text:Ah[e.kind][0],submit:Ah[e.kind][1],explain:Ah[e.kind][2],request:({decided_by:t,reason:n})=>e.kind===`hold`&&e.changeset_id!==null?{kind:`accept`,changeset_id:e.changeset_id,decided_by:t,reason:n}:{kind:`withdraw`,decision_id:e.decision_id,decided_by:t,reason:n},done:e.kind===`hold`?`Accepted.`:`Withdrawn.`}),Mh=({changeset_id:e,drive_id:t,kind:n})=>({text:`Revert ${n} …`,explain:`Takes ${t} out of the map. Observations of other drives stay, and you can withdraw the decision.`,submit:`Revert this ${n}`,request:({decided_by:t,reason:n})=>({kind:`revert`,changeset_id:e,decided_by:t,reason:n}),done:`Reverted.`}),Nh={suppress:`Suppressed`,pin:`Pinned`,classify:`Class corrected`,approve:`Approved`,revert:`Reverted`,accept:`Accepted`,hold:`On hold`};function Ph(e){return _(`div`,{class:`decision`},_(`b`,{textContent:`${Nh[e.kind]}${e.drive_id?` ${e.drive_id}`:``}`}),` by ${e.decided_by??(e.kind===`hold`?`the health checks`:`unknown`)}`,!!e.reason&&`: ${e.reason}`,_(`small`,{textContent:`${T(e.decided_at)}${e.radius_m===null?``:` · within ${e.radius_m} m`}`}))}function Fh(e){let n=_(`p`,{class:`decide-status`,role:`status`,aria:{live:`polite`},hidden:!0}),r=_(`div`,{class:`decide-buttons`}),i=_(`div`,{});e.append(r,_(`div`,{class:`decide-popup`},i,n));let a=``,o=!1;function s(e,t){n.hidden=!e,n.textContent=e,n.classList.toggle(`bad`,t),n.classList.toggle(`good`,!!e&&!t)}function c(e,t,n){if(e===a)return;let o=e.split(` `)[0]===a.split(` `)[0];a=e,o||s(``,!1),b(i);let c=r.contains(document.activeElement);b(r,...t.map(e=>{let t=_(`button`,{type:`button`,textContent:e.text,aria:{expanded:`false`}});return t.addEventListener(`click`,()=>u(e,t,n)),t})),c&&r.querySelector(`button`)?.focus()}function l(e){b(i),s(``,!1);for(let e of r.children)e.setAttribute(`aria-expanded`,`false`);e?.focus()}function u(e,t,n){let r=t.getAttribute(`aria-expanded`)===`true`;if(l(null),r)return;t.setAttribute(`aria-expanded`,`true`);let a=d(e,n,()=>l(t));b(i,a),a.querySelector(`input:placeholder-shown`)?.focus()}function d(e,n,r){let i=e=>_(`input`,{type:`text`,required:!0,autocomplete:`off`,placeholder:` `,...e}),a=i({name:`name`,value:Dh.name(),minLength:2,maxLength:80,autocomplete:`name`});a.readOnly=Dh.person()!==null;let c=i({name:`reason`,minLength:3,maxLength:500}),l=_(`input`,{type:`number`,name:`radius`,value:`1`,min:`0.1`,max:`20`,step:`0.1`,required:!0}),u=i({name:`token`,type:`password`,autocomplete:`off`}),d=Ih(`Writer token`,u,`In the file that conetl view names when it starts. Kept for this tab only.`);Dh.token()!==null&&(u.required=!1,d.hidden=!0);let f=_(`button`,{type:`submit`,class:`primary`,textContent:e.submit}),p=_(`button`,{type:`button`,textContent:`Cancel`,onclick:r}),m=_(`form`,{class:`decide`,noValidate:!1},_(`p`,{class:`hint`,textContent:e.explain}),Ih(`Your name`,a),Ih(`Reason`,c,`Name and reason are visible to everyone who sees the map.`),e.withRadius&&Ih(`Radius (m)`,l),d,_(`div`,{class:`decide-actions`},f,p));m.addEventListener(`keydown`,e=>{e.key===`Escape`&&(e.stopPropagation(),o||r())}),m.addEventListener(`submit`,e=>{e.preventDefault(),o||v()});let h=()=>d.hidden?Dh.token()??``:u.value.trim();async function v(){let t=h(),i={decided_by:a.value.trim(),reason:c.value.trim(),radius_m:Number(l.value)};o=!0;for(let e of[a,c,l,u,p])e.disabled=!0;f.disabled=!0,f.textContent=`Writing …`,s(``,!1);try{let a=await g.decide(n.map,e.request(i),t);y(),r(),s([`${e.done} ${E(a.versions_written,`feature version`)} written, ${E(a.replayed,`drive`)} replayed.`,...a.hold_changes,a.report_problem].filter(Boolean).join(` `),a.report_problem!==null),n.changed()}catch(e){b(e)}finally{o=!1}}function y(){Dh.keep(a.value.trim(),h())}function b(i){i instanceof t&&![0,401,403].includes(i.status)&&y();for(let e of[a,c,l,u,p])e.disabled=!1;f.disabled=!1,f.textContent=e.submit;let o=i instanceof Error?i.message:String(i);if(i instanceof t&&i.status===401)return Dh.forget(),d.hidden=!1,u.required=!0,u.value=``,u.focus(),s(`Nothing was written. ${o}`,!0);if(i instanceof t&&i.status===409)return r(),s(`Nothing was written. ${o}${Lh(i.body)}`,!0),n.changed();f.focus(),s(`Nothing was written. ${o}`,!0)}return m}return{show:c}}function Ih(e,t,n=``){return _(`label`,{},_(`span`,{textContent:e}),t,!!n&&_(`small`,{textContent:n}))}function Lh(e){let t=typeof e==`object`&&e&&`now`in e?e.now:null;if(!t)return``;let[n,r]=t.map_xyz_m;return` It is now version ${t.version}, ${L[t.kind].label} by ${t.drive_id}, at ${n.toFixed(3)} E ${r.toFixed(3)} N.`}function Rh(e,t){return n=>{e.hidden=!n?.decisions.length,n&&b(e,_(`h2`,{textContent:`Decisions`}),...n.decisions.slice(0,50).map(e=>_(`button`,{type:`button`,class:`decision-row`,title:`Show`,onclick:()=>t(e)},Ph(e))),n.decisions.length>50&&_(`p`,{class:`hint`,textContent:`${n.decisions.length-50} older decisions: run conetl map decisions to list them.`}))}}var zh=[[`geojson`,`GeoJSON`,850],[`csv`,`CSV`,420],[`gpkg`,`GeoPackage`,500]],Bh=`conetl.feed`;function Vh(e,n){let r=_(`button`,{type:`button`,class:`link`,aria:{expanded:`false`,controls:`downloads`}},`Download`),i=_(`div`,{class:`menu-popup`,id:`downloads`,hidden:!0,role:`group`,aria:{label:`Download`}});e.append(_(`div`,{class:`menu-host`},r,i));let a=v(r,i,()=>o());document.addEventListener(`pointerdown`,e=>{!i.hidden&&e.target instanceof Node&&!i.contains(e.target)&&e.target!==r&&a(!1)});function o(){let e=n.shown();if(!e)return b(i,_(`p`,{class:`hint`,textContent:`There is nothing to download: the view shows no drive.`}));let t=_(`input`,{type:`checkbox`}),r=_(`div`,{class:`download-links`}),a=()=>{let n=t.checked&&e.box?e.box.map(e=>e.toFixed(2)).join(`,`):null,i={valid_at:e.at.valid,known_at:e.at.known};b(r,...zh.map(([t,r,a])=>c(r,g.download(e.map,t,{...i,box:n}),n?``:Uh(e.coneCount*a))),...e.since?zh.slice(0,2).map(([t,n])=>c(`Changes, ${n}`,g.download(e.map,t,{...i,from_valid_at:e.since}),``)):[])};t.addEventListener(`change`,a),a(),b(i,_(`p`,{},_(`strong`,{textContent:e.map}),` ${e.title}`),_(`p`,{class:`hint`,textContent:`${Ce(e.coneCount)} on the road; filters do not apply`}),e.box&&_(`label`,{class:`check`},t,`Only the area in view`),r,u(e),_(`button`,{type:`button`,class:`download-link`,onclick:()=>void f(e)},`Image of the view`,_(`small`,{textContent:`PNG`})),e.drive&&e.drive.frame_pair_count>0&&l(e.map,e.drive))}let c=(e,t,n)=>_(`a`,{class:`download-link`,href:t,download:``},e,_(`small`,{textContent:n})),l=(e,t)=>_(`a`,{class:`download-link`,href:g.report(e,t.changeset_no),target:`_blank`,rel:`noopener`},`Report on ${t.drive_id}`,_(`small`,{textContent:`HTML`}));function u(e){let[t,n]=(localStorage.getItem(Bh)??`
`).split(`
`),r=(e,t)=>_(`input`,{type:`text`,required:!0,maxLength:200,value:t??``,placeholder:e,aria:{label:e}}),[i,a]=[r(`Publisher`,t),r(`Road name`,n)],o=_(`form`,{},i,a,_(`button`,{type:`submit`,textContent:`Download WZDx`}));return o.addEventListener(`submit`,t=>{t.preventDefault(),localStorage.setItem(Bh,`${i.value}\n${a.value}`),d(g.download(e.map,`wzdx`,{valid_at:e.at.valid,publisher:i.value,road_name:a.value}))}),_(`details`,{},_(`summary`,{class:`download-link`},`Work zones, WZDx 4.2`),o)}async function d(e){try{let n=await fetch(e);if(!n.ok)throw new t(s(await n.json())??``,n.status);let r=/filename="([^"]+)"/.exec(n.headers.get(`content-disposition`)??``)?.[1]??`wzdx.geojson`;Wh(await n.blob(),r)}catch(e){n.failed(`The file could not be created: ${j(e)}`)}}async function f(e){try{Wh(await n.picture(),`${e.map}_${Hh(e.at.valid??new Date().toISOString())}.png`)}catch(e){n.failed(`The image could not be created: ${j(e)}`)}}}var Hh=e=>`${S(e).replace(` `,`T`).replaceAll(`:`,`-`)}Z`,Uh=e=>e>=1e6?`about ${Math.round(e/1e6)} MB`:`about ${Math.max(1,Math.round(e/1e3))} kB`;function Wh(e,t){let n=URL.createObjectURL(e);_(`a`,{href:n,download:t}).click(),window.setTimeout(()=>URL.revokeObjectURL(n),1e4)}function Gh(e,t,n){let r=e.width/Math.max(e.clientWidth,1),i=_(`canvas`,{width:e.width,height:e.height+Math.round(30*r)}),a=i.getContext(`2d`);if(!a)throw Error(`this browser has no 2D canvas`);a.fillStyle=`#ffffff`,a.fillRect(0,0,i.width,i.height),a.drawImage(e,0,0),a.scale(r,r),a.font=`13px system-ui, sans-serif`,a.fillStyle=`#1d2733`,a.textBaseline=`middle`;let o=e.clientHeight+15;a.fillText(n,10,o,e.clientWidth-200);let s=t.querySelector(`.scalebar i`),c=t.querySelector(`.scalebar span`)?.textContent??``,l=s?.offsetWidth??0;return a.textAlign=`right`,a.fillText(c,e.clientWidth-10,o),l&&a.fillRect(e.clientWidth-22-a.measureText(c).width-l,o-1.5,l,3),new Promise((e,t)=>i.toBlob(n=>n?e(n):t(Error(`the image is too large`)),`image/png`))}var Kh=Math.sqrt(-2*Math.log(.05)),qh=1.6,Jh=8,Yh=.3,Xh=60,Zh=[64,20],Qh=10;function $h(e){let[t,n,,r]=e,i=(t+r)/2,a=Math.hypot((t-r)/2,n);return{major_m:Kh*Math.sqrt(i+a),minor_m:Kh*Math.sqrt(Math.max(i-a,0)),angle_rad:.5*Math.atan2(2*n,t-r)}}var eg=({xyz:[e,t,n],height_m:r})=>[e,t,n+r],tg=e=>[1,10,100,1e3].find(t=>e.major_m*t>=.3)??1e3;function ng(e,t){let n=new fi,r=new fi,i=new fi;e.scene.add(n,r,i);let a=_(`div`,{class:`labels`,aria:{hidden:`true`}});t.append(a);let o=[];return cp(()=>n.traverse(e=>{(e instanceof go||e instanceof Ha)&&e.material.color.set(ip().path)})),e.beforeDraw(()=>{let t=[];for(let{at:n,node:r,near:i}of o){let a=e.project(n);if(r.hidden=a===null||t.some(([e,t])=>Math.abs(e-a[0])<Zh[0]&&Math.abs(t-a[1])<Zh[1]),!a||r.hidden)continue;t.push(a);let o=i.map(t=>e.project(t)).filter(e=>e!==null),s=e=>o.some(([t,n])=>{let[r,i]=[(t-a[0])*e,a[1]-n];return r>0&&r<Zh[0]+16&&i>0&&i<2*Zh[1]+4});r.classList.toggle(`left`,s(1)&&!s(-1)),r.style.transform=`translate(${Math.round(a[0])}px, ${Math.round(a[1])}px)`}}),{showPaths(t){rg(n);for(let e of t){let t=new go(ig(e.xyz_m),new so({color:ip().path}));n.add(t,...sg(e.xyz_m))}e.draw()},showSelection(t,n,i,a){if(rg(r),a){let e=new xo(ig([...ag(a,Yh),...ag(a,-.3).reverse()]),new so({color:ip().ellipse,depthTest:!1}));e.renderOrder=2,r.add(e)}if(t&&n){let e=new Fo(1,72),a=Array.from({length:72},(e,t)=>new q(Math.cos(t*Math.PI/36),Math.sin(t*Math.PI/36),0)),o=new xo(new ma().setFromPoints(a),new so({color:ip().ellipse,depthTest:!1})),s=new Ha(e,new Aa({color:ip().ellipse,transparent:!0,opacity:.22,depthTest:!1,side:2}));for(let e of[s,o])e.scale.set(n.major_m*i,n.minor_m*i,1),e.rotation.z=n.angle_rad,e.position.set(t[0],t[1],t[2]+.01),e.renderOrder=2,r.add(e)}e.draw()},showCamera(t,n){if(rg(i),t){let e=new q(...t.xyz_m),[r,a]=[-t.cx_px/t.fx_px,-t.cy_px/t.fy_px],[o,s]=[r+t.width_px/t.fx_px,a+t.height_px/t.fy_px],c=[[r,a,1],[o,a,1],[o,s,1],[r,s,1]].map(n=>e.clone().add(og(t.map_R_camera,n).multiplyScalar(qh))),l=[];c.forEach((t,n)=>l.push(e,t,t,c[(n+1)%4]??t));let[u,d]=[c[0],c[1]];if(u&&d){let e=u.clone().lerp(d,.5).add(og(t.map_R_camera,[0,-.25,0]));l.push(u.clone().lerp(d,.35),e,e,u.clone().lerp(d,.65))}let f=new bo(new ma().setFromPoints(l),new so({color:ip().camera}));i.add(f);let p=new so({color:ip().camera,transparent:!0,opacity:.55});n&&i.add(new go(new ma().setFromPoints([e,new q(...n)]),p))}e.draw()},showLabels(t,n){let r=t.filter(e=>e.id!==n&&e.kind===`moved`&&e.shift_m!==null).slice(0,Xh);o=[...t.filter(e=>e.id===n),...r].map(e=>{let r=e.id===n,i=[r?e.id.slice(0,8):``,e.kind===`moved`&&e.shift_m!==null?`${e.shift_m.toFixed(2)} m`:``].filter(Boolean).join(` · `),a=_(`span`,{class:r?`label chosen`:`label`,textContent:i});a.style.setProperty(`--colour`,sp(e.kind));let o=t.filter(t=>t!==e&&Math.abs(t.xyz[0]-e.xyz[0])<Qh&&Math.abs(t.xyz[1]-e.xyz[1])<Qh);return{at:eg(e),node:a,near:o.map(eg)}}),a.replaceChildren(...o.map(({node:e})=>e)),e.draw()}}}function rg(e){let t=[...e.children];for(let n of t)e.remove(n),(n instanceof Ha||n instanceof go)&&n.geometry.dispose()}function ig(e){return new ma().setAttribute(`position`,new na(e.flat(),3))}function ag(e,t){return e.map(([n,r,i],a)=>{let[o,s]=Fm(e,a);return[n+t*o,r+t*s,i]})}function og(e,t){let[n,r,i]=e.map(e=>e[0]*t[0]+e[1]*t[1]+e[2]*t[2]);return new q(n,r,i)}function sg(e){let t=new ec(new ms().moveTo(.45,0).lineTo(-.3,.3).lineTo(-.12,0).lineTo(-.3,-.3).closePath()),n=[],r=Jh/2;for(let i=1;i<e.length;i++){let[a,o]=[e[i-1],e[i]];a&&o&&(r+=Math.hypot(o[0]-a[0],o[1]-a[1]),r<Jh||(r=0,n.push(t.clone().rotateZ(Math.atan2(o[1]-a[1],o[0]-a[0])).translate(...o))))}return n.length?[new Ha(xm(n),new Aa({color:ip().path,side:2}))]:[]}function cg(e,t,n,r){let{canvas:i}=e,a=null;function o(){let n=a&&e.project(eg(a));t.tip(n&&a,...n??[0,0])}function s(e){a=e,o()}e.beforeDraw(o);let c=null;i.addEventListener(`pointerdown`,e=>{c=[e.clientX,e.clientY]}),i.addEventListener(`pointerup`,e=>{if(!c||e.button!==0||Math.hypot(e.clientX-c[0],e.clientY-c[1])>5)return;if(n.click(e.offsetX,e.offsetY))return s(null);let t=n.pick(e.offsetX,e.offsetY);if(!t)return r.click(e.offsetX,e.offsetY)?void 0:n.clickGround(e.offsetX,e.offsetY);s(null),r.select(t.id)});let l=!1;return i.addEventListener(`pointermove`,e=>{l||e.buttons||e.pointerType===`touch`||(l=!0,requestAnimationFrame(()=>{l=!1;let t=n.pick(e.offsetX,e.offsetY);i.classList.toggle(`over`,t!==null),s(t)}))}),i.addEventListener(`pointerleave`,()=>s(null)),window.addEventListener(`keydown`,i=>{if(i.ctrlKey||i.metaKey||i.altKey)return;let a=i.target instanceof HTMLElement?i.target:document.body,o=a.matches(`select, input:not([type=range]):not([type=checkbox])`),s=r.covering(i,o);s===null?i.key===`Escape`?o?a.blur():!t.closeHelp()&&!n.escape()&&r.select(null):o||a.matches(`input[type=range]`)&&y.test(i.key)||(n.key(i)||r.key(i)||e.key(i))&&i.preventDefault():s&&i.preventDefault()}),{shown:e=>s(a&&(e.find(e=>e.id===a?.id)??null))}}var[lg,ug]=[120,32],dg=.75;function fg(e,t){let n=[],r=[],i=null,a=null,o=_(`div`,{class:`list-tabs`,role:`tablist`,aria:{label:`Lists`}}),s=_(`div`,{class:`list-grip`,role:`separator`,tabIndex:0,title:`Drag, or press ↑ ↓, to change the height`,aria:{orientation:`horizontal`,label:`Height of the list`,valuemin:String(lg),valuenow:`264`}}),c=_(`button`,{type:`button`,class:`close`,textContent:`×`,title:`Close the list (L)`,aria:{label:`Close the list`},onclick:()=>f(null)}),l=_(`div`,{class:`list-head`},o,_(`span`,{class:`space`}),c),u=_(`div`,{class:`list-bodies`});e.append(s,l,u);function d(r){a=r===null?null:(n.find(e=>e.id===r)??n[0])?.id??null,a!==null&&(i=a),e.hidden=a===null,t.setAttribute(`aria-expanded`,String(a!==null));for(let e of n){let t=e.id===a;e.button.setAttribute(`aria-selected`,String(t)),e.button.tabIndex=t?0:-1,e.host.hidden=!t,t&&p(e)}}function f(e){let t=a;if(d(e),a!==t)for(let e of r)e(a)}function p(e){e.stale&&(e.stale=!1,e.render(e.host))}o.addEventListener(`keydown`,e=>{let t=n.findIndex(e=>e.id===a),r=e.key===`ArrowRight`?1:e.key===`ArrowLeft`?-1:0,i=r?n[(t+r+n.length)%n.length]:void 0;i&&(e.preventDefault(),e.stopPropagation(),f(i.id),i.button.focus())});function m(t){let n=Math.round(Math.min(Math.max(t,lg),window.innerHeight*dg));e.style.setProperty(`--list-height`,`${n}px`),s.setAttribute(`aria-valuenow`,String(n))}s.addEventListener(`pointerdown`,t=>{s.setPointerCapture(t.pointerId);let[n,r]=[t.clientY,e.offsetHeight],i=e=>m(r+n-e.clientY);s.addEventListener(`pointermove`,i),s.addEventListener(`lostpointercapture`,()=>s.removeEventListener(`pointermove`,i),{once:!0})}),s.addEventListener(`keydown`,t=>{let n=t.key===`ArrowUp`?ug:t.key===`ArrowDown`?-ug:0;n&&(t.preventDefault(),t.stopPropagation(),m(e.offsetHeight+n))});let h={addTab(e,t){let r=e.toLowerCase(),i=_(`span`,{class:`list-count`}),s=_(`button`,{type:`button`,role:`tab`,id:`list-tab-${r}`,onclick:()=>f(r),aria:{selected:`false`,controls:`list-${r}`}},e,i);s.tabIndex=-1;let c=_(`div`,{class:`list-body`,id:`list-${r}`,role:`tabpanel`,hidden:!0,aria:{labelledby:s.id}}),l={id:r,button:s,host:c,render:t,stale:!0};return n.push(l),o.append(s),u.append(c),{count:(t,n=e)=>{s.firstChild&&(s.firstChild.nodeValue=n),i.textContent=t===null?``:t.toLocaleString(`en`),s.title=t===null?``:E(t,`row`)},show:()=>f(r),redraw:()=>{l.stale=!0,a===r&&p(l)},get visible(){return a===r}}},open:d,toggle:()=>f(a===null?i??n[0]?.id??null:null),get opened(){return a},onChange:e=>void r.push(e)};return t.addEventListener(`click`,()=>h.toggle()),d(null),h}var pg=[[`Drag, right drag, wheel`,`rotate, pan, zoom`],[`← ↑ → ↓, with Shift`,`pan, rotate`],[`+ −`,`zoom`],[`Home`,`show everything`],[`T`,`plan (north up) or 3D`],[`M`,`measure`],[`X`,`copy the coordinates under the cursor`],[`,  .`,`previous, next drive`],[`B, C`,`before or after the drive, changes`],[`1, 2`,`show or hide LiDAR points, lane boundaries`],[`P, N`,`previous, next image along the drive`],[`I, F, V`,`full images of the selected cone, camera follows image, before and after as a swipe`],[`R, D`,`review changes, differences from plans`],[`/`,`search`],[`L`,`open or close the list`],[`[  ] or K, J`,`previous, next row of the list`],[`Esc`,`close what is open`]],mg={live:`live`,waiting:`no connection`,trouble:`database error`};function hg(e){let t=_(`main`,{class:`view`}),n=_(`aside`,{class:`sidebar`,id:`sidebar`,aria:{label:`Map and legend`}}),r=_(`aside`,{class:`panel`,hidden:!0,aria:{label:`Selected object`}}),i=_(`section`,{class:`list`,hidden:!0,aria:{label:`Lists`}}),a=_(`button`,{type:`button`,class:`link`,aria:{expanded:`false`}},`List `,_(`kbd`,{textContent:`L`})),o=fg(i,a),s={search:_(`div`,{class:`tool-search`}),download:_(`div`,{}),more:_(`div`,{class:`tool-more`})},c=_(`footer`,{class:`timeline`}),l=_(`h1`,{class:`brand`}),u=_(`span`,{class:`who`,hidden:!0,title:`Logged in`}),d=_(`span`,{class:`status`,role:`status`},_(`i`),_(`span`,{textContent:`connecting`}));d.dataset.status=`waiting`;let f=_(`div`,{class:`progress`,hidden:!0}),p=_(`div`,{class:`card-host`,hidden:!0}),m=_(`div`,{class:`scene-notice`,hidden:!0,role:`status`}),h=_(`div`,{class:`toasts`,aria:{live:`polite`}}),g=_(`div`,{class:`tip`,hidden:!0,aria:{hidden:`true`}}),v=null,y=_(`input`,{type:`password`,name:`token`,required:!0,autocomplete:`current-password`}),x=_(`p`,{class:`hint bad`,role:`alert`}),S=_(`form`,{},_(`h2`,{textContent:`Log in again`}),_(`p`,{class:`hint`,textContent:"The login has expired. `conetl status` prints the address with the token."}),_(`label`,{},`Token `,y),x,_(`button`,{type:`submit`,class:`primary`,textContent:`Log in`})),C=_(`dialog`,{class:`help login`},S),w=null,T=_(`dialog`,{class:`help`},_(`h2`,{textContent:`Shortcuts`}),_(`dl`,{},...pg.flatMap(([e,t])=>[_(`dt`,{textContent:e}),_(`dd`,{textContent:t})])),_(`p`,{class:`hint`,textContent:`Cones are drawn with their measured height and a standard width; markers have a fixed size.`}),_(`button`,{type:`button`,textContent:`Close`,onclick:()=>T.close()})),D=_(`button`,{type:`button`,class:`menu`,textContent:`☰ Legend`,aria:{expanded:`false`,controls:`sidebar`}}),A=t=>{e.classList.toggle(`menu-open`,t),D.setAttribute(`aria-expanded`,String(t))};D.addEventListener(`click`,()=>A(!e.classList.contains(`menu-open`))),document.addEventListener(`pointerdown`,e=>{e.target instanceof Node&&!n.contains(e.target)&&e.target!==D&&A(!1)}),document.addEventListener(`keydown`,e=>{e.key===`Escape`&&A(!1)});let N=_(`button`,{type:`button`,class:`link help-button`,onclick:()=>T.showModal()},`Shortcuts `,_(`kbd`,{textContent:`?`}));e.append(_(`header`,{class:`top`},D,l,s.search,_(`span`,{class:`space`}),u,d,s.download,a),f,n,t,r,i,c,h,T,C),t.append(p,m,g),s.more.append(N);let P=window.matchMedia(`(max-width: 760px)`),ee=()=>(P.matches?n:e.querySelector(`.top`))?.append(s.more);P.addEventListener(`change`,ee),ee(),e.classList.toggle(`embedded`,I),I&&t.append(oe());function F(e){let t=e.kind===`moved`&&e.shift_m!==null?` by ${e.shift_m.toFixed(2)} m`:``;b(g,_(`b`,{},ue(e.kind),`${L[e.kind].label}${t}`),!B()&&_e(e.category).label,e.marking&&_(`span`,{textContent:Nm(e.marking)}),_(`span`,{class:`mono`,textContent:M(e.id)}),_(`span`,{textContent:`sure it stands: ${O(e.probability)}, accuracy ±${k(e.sigma_m)}, ${E(e.observations,`observation`)}`}))}return{app:e,view:t,sidebar:n,panel:r,timeline:c,brand:l,listPane:o,tools:s,busy:e=>void(f.hidden=!e),empty:t=>void e.classList.toggle(`is-empty`,t),panelOpen:t=>void e.classList.toggle(`panel-open`,t),card(e,t=``,n={}){if(p.hidden=e===null,e===null)return;let{action:r}=n;b(p,_(`div`,{class:n.busy?`card busy`:`card`,role:n.busy?`status`:`alert`},_(`h2`,{textContent:e}),!!t&&_(`p`,{textContent:t}),n.code&&_(`code`,{textContent:n.code}),r&&_(`button`,{type:`button`,class:`primary`,textContent:r.text,onclick:()=>r.run()})))},logIn(e){return w??=new Promise((t,n)=>{C.oncancel=()=>n(Error(`You are not logged in.`)),S.onsubmit=n=>{n.preventDefault(),e(y.value.trim()).then(e=>{x.textContent=e?``:`This token is wrong.`,y.value=``,e&&t()},e=>x.textContent=j(e))},C.showModal()}).finally(()=>{C.close(),w=null}),w},notice(e){m.hidden=e===null,m.textContent=e},toast(e,t){if([...h.children].some(t=>t.firstChild?.textContent===e))return;let n=_(`div`,{class:`toast`},_(`span`,{textContent:e})),r=()=>n.remove();t&&n.append(_(`button`,{type:`button`,class:`link`,textContent:t.text,onclick:()=>(t.run(),r())})),n.append(_(`button`,{type:`button`,class:`link`,textContent:`×`,aria:{label:`Dismiss`},onclick:r})),h.append(n),window.setTimeout(r,t?6e4:8e3)},status(e,t){d.dataset.status=e,d.title=t;let n=d.lastElementChild;n&&n.textContent!==mg[e]&&(n.textContent=mg[e])},tip(e,n,r){if(g.hidden=e===null,!e)return;e!==v&&F(v=e);let i=n+14+g.offsetWidth>t.clientWidth?n-14-g.offsetWidth:n+14;g.style.transform=`translate(${i}px, ${Math.max(4,r-g.offsetHeight/2)}px)`},person(e){u.hidden=e===null,u.textContent=e},openHelp:()=>void(T.open||T.showModal()),closeHelp:()=>{let e=T.open;return e&&T.close(),e}}}var gg=60,_g=60;function vg(e,t){let n=null,r=new Map,i=new Map,a=0;function o(t){let[a,o,s]=[n,r,i];if(!a||o.has(t))return Promise.resolve();let c=s.get(t);if(c)return c;let l=o.get(t-1),u=a(t*100,l?.next??null).then(n=>{s.delete(t),o.set(t,n);for(let e of[...o.keys()].slice(0,Math.max(o.size-gg,0)))o.delete(e);o===r&&e()});return s.set(t,u),u}return{open(e,t){window.clearTimeout(a),[n,r,i]=[e,new Map([[0,t]]),new Map]},row:e=>r.get(Math.floor(e/100))?.rows[e%100],find(e){for(let[t,{rows:n}]of r){let r=n.findIndex(e);if(r>=0)return t*100+r}return null},want(e,n){window.clearTimeout(a);let i=[Math.floor(e/100),Math.floor(Math.max(n-1,e)/100)].filter(e=>!r.has(e));i.length&&(a=window.setTimeout(()=>void Promise.all([...new Set(i)].map(o)).catch(t),_g))},async rowAt(e){return await o(Math.floor(e/100)),this.row(e)}}}var yg=26,bg=16e6,xg=3,Sg=140,Cg=0;function wg(e){let t=`table-${++Cg}`,n=[],r=[],i=0,a=``,o=null,s=[],c=!1,l=0,u=_(`div`,{class:`row`,role:`row`,aria:{rowindex:`1`}}),d=_(`div`,{class:`table-space`,role:`rowgroup`}),f=_(`p`,{class:`table-none hint`,hidden:!0}),p=_(`div`,{class:`table`,role:`grid`,tabIndex:0,aria:{label:e.label}},_(`div`,{class:`table-head`,role:`rowgroup`},u),d),m=_(`div`,{class:`table-wrap`},p,f),h=()=>Math.max(p.clientHeight-yg,1),g=()=>i*yg<=bg?1:(i*yg-h())/(bg-h()),v=()=>p.scrollTop*g();function y(t){n=t,r=n.map(t=>{let n=_(`button`,{type:`button`,textContent:t.title,title:t.hint??``,onclick:()=>e.sort(Tg(t,a))});return _(`div`,{class:t.number?`cell number`:`cell`,role:`columnheader`},n)}),b(u,...r),p.setAttribute(`aria-colcount`,String(n.length)),p.style.setProperty(`--columns`,n.map(e=>e.width).join(` `)),p.style.setProperty(`--least`,`calc(20px + ${n.map(e=>/\d+px/.exec(e.width)?.[0]??`0px`).join(` + `)})`);for(let e of s.splice(0))e.node.remove()}function x(){let r=Math.min(i,Math.ceil(p.clientHeight/yg)+6);for(;s.length<r;){let e=Eg(n,t,s.length);s.push(e),d.append(e.node)}for(let e of s.splice(r))e.node.remove();let a=Math.max(0,Math.floor(v()/yg)-xg),c=Math.max(0,Math.min(a,i-r));for(let t=c;t<c+r;t++)s[t%r]?.set(e.row(t),t,t*yg-v()+p.scrollTop,t===o);r&&e.wanted(c,c+r);let l=s.find(e=>e.chosen);l?p.setAttribute(`aria-activedescendant`,l.node.id):p.removeAttribute(`aria-activedescendant`)}function S(){c||(c=!0,requestAnimationFrame(()=>{c=!1,x()}))}function C(e){let t=e*yg;t<v()?p.scrollTop=t/g():t+yg>v()+h()&&(p.scrollTop=(t+yg-h())/g())}return p.addEventListener(`scroll`,S,{passive:!0}),new ResizeObserver(S).observe(p),d.addEventListener(`click`,t=>{let n=t.target instanceof Element?t.target.closest(`[data-index]`):null;n&&(o=Number(n.dataset.index),x(),e.chosen(o))}),p.addEventListener(`keydown`,t=>{if(t.target!==p||t.ctrlKey||t.metaKey||t.altKey||!i)return;let n=Math.max(1,Math.floor(p.clientHeight/yg)-2),r={ArrowDown:1,ArrowUp:-1,PageDown:n,PageUp:-n,Home:-i,End:i}[t.key];if(r===void 0&&t.key!==`Enter`)return;t.preventDefault(),t.stopPropagation();let a=Math.max(0,Math.min(i-1,o===null?r===1?0:r??0:o+(r??0)));o=a,C(a),x(),window.clearTimeout(l),l=window.setTimeout(()=>e.chosen(a),Sg)}),{node:m,show(e,t,o,c){o!==n&&y(o),i=e,a=t,d.style.height=`${Math.min(i*yg,bg)}px`,p.setAttribute(`aria-rowcount`,String(i+1)),f.hidden=i>0,f.textContent=c,n.forEach((e,n)=>{let i=t===e.id?`ascending`:t===`${e.id}-`?`descending`:`none`;r[n]?.setAttribute(`aria-sort`,i)});for(let e of s)e.forget();x()},choose(e,t){o=e,e!==null&&t&&C(e),x()},draw:x}}function Tg(e,t){return t===e.id?`${e.id}-`:t===`${e.id}-`?e.id:e.descending?`${e.id}-`:e.id}function Eg(e,t,n){let r=e.map(e=>_(`div`,{class:e.number?`cell number`:`cell`,role:`gridcell`})),i=_(`div`,{class:`row`,role:`row`,id:`${t}-${n}`},...r),[a,o,s,c]=[null,-1,-1,!1];return{node:i,get chosen(){return c},forget:()=>void(a=null),set(t,n,l,u){l!==s&&(i.style.transform=`translateY(${s=l}px)`),n!==o&&(o=n,i.dataset.index=String(n),i.setAttribute(`aria-rowindex`,String(n+2)),i.classList.toggle(`odd`,n%2==1)),(u!==c||a===null)&&(c=u,i.setAttribute(`aria-selected`,String(u))),t!==a&&(a=t,e.forEach((e,n)=>{let i=r[n];i&&(t===void 0?i.textContent=``:e.icon?b(i,e.icon(t),e.text(t)):i.textContent=e.text(t),e.whole&&(i.title=t===void 0?``:e.whole(t)))}))}}}var Dg={cones:`existence`,changes:`shift-`},Og=150,kg=5e3,Ag=e=>e.length>26?`${e.slice(0,10)}…${e.slice(-14)}`:e,jg=(e,t,n)=>e.xyz[t]+n[t];function Mg(t,n){let r=null,i=null,a=new Map,o=!0,s=()=>i?.timeline?.origin_m??[0,0,0],c=()=>i?.timeline?.changesets??[],l=e=>a.get(e.changeset)??``,u=[{id:`id`,title:`Id`,hint:`First 8 characters of the id`,width:`80px`,text:e=>M(e.id)},{id:`class`,title:`Class`,width:`minmax(136px, 1fr)`,text:e=>_e(e.category).label,icon:e=>z(e.category)},{id:`kind`,title:`Kind`,width:`minmax(140px, 1fr)`,text:e=>r?Le(e.kind,r):``,icon:e=>ue(e.kind)},{id:`existence`,title:`Existence`,hint:`Existence probability`,width:`96px`,number:!0,text:e=>D(e.probability)},{id:`sigma`,title:`Sigma m`,hint:`Horizontal sigma, along the major axis of the error ellipse`,width:`92px`,number:!0,descending:!0,text:e=>e.sigma_m.toFixed(3)},{id:`height`,title:`Object m`,hint:`Height of the object`,width:`88px`,number:!0,text:e=>e.height_m?e.height_m.toFixed(2):``},{id:`shift`,title:`Shift m`,hint:`Horizontal shift. Sorted: moved, then added and removed, then confirmed`,width:`84px`,number:!0,descending:!0,text:e=>e.shift_m===null?``:e.shift_m.toFixed(3)},{id:`drive`,title:`Drive`,hint:`Last drive that observed or changed it`,width:`minmax(184px, 1.6fr)`,text:e=>Ag(l(e)),whole:l},{id:`seen`,title:`Last seen (UTC)`,width:`128px`,descending:!0,text:e=>S(new Date(e.seenAt).toISOString(),!1)},{id:`observations`,title:`Obs.`,hint:`Observations in total`,width:`58px`,number:!0,descending:!0,text:e=>e.observations.toLocaleString(`en`)},{id:`east`,title:`East m`,hint:`Easting in the map's CRS`,width:`96px`,number:!0,text:e=>jg(e,0,s()).toFixed(2)},{id:`north`,title:`North m`,hint:`Northing in the map's CRS`,width:`104px`,number:!0,text:e=>jg(e,1,s()).toFixed(2)}],d=Ie(n),f={cones:p(`Cones`,`cones`),changes:p(`Changes`,`changes`)};function p(e,a){let s=u.filter(e=>a===`changes`||e.id!==`shift`&&e.id!==`kind`),l=s.filter(e=>e.id!==`class`),f=()=>Se().size>1?s:l,p=a===`cones`?`features`:`changes`,[m,_,v]=[``,null,0],y=null,b=vg(()=>(x.draw(),k(!1)),n.failed),x=wg({label:e,row:b.row,wanted:b.want,sort:e=>n.change({sort:e===Dg[a]?null:e},!1),chosen:e=>void b.rowAt(e).then(e=>{e&&(o=!1,n.select(e.id,!0))},n.failed)}),S=t.addTab(e,e=>{x.node.isConnected||e.append(x.node),e.prepend(d.node),T(),window.clearTimeout(v),v=window.setTimeout(()=>void D().catch(n.failed),m?Og:0)}),C=()=>(a===`cones`?i?.featureCount:[...i?.kinds.values()??[]].reduce((e,t)=>e+t,0))??0,w=()=>{let e=r?.sort??null;return e!==null&&f().some(t=>t.id===e.replace(/-$/,``))?e:Dg[a]};function T(){r&&d.show(r,a===`changes`?i?.kinds??new Map:new Map,C(),y??C(),c())}let E=e=>async(t,r)=>{let o={...e,limit:`100`,...r===null?{offset:String(t)}:{after:r}},s=i?.map??``;if(a===`changes`){let{changes:e,next:t}=await g.changePage(s,o);return{rows:n.withDecisions(e.map(Gp)),next:t}}let{features:c,next:l}=await g.featurePage(s,o);return{rows:c.map(Wp),next:l}};async function D(){if(!r||!i)return;let e=a===`cones`?i.features:i.changes,t=je(r,a===`changes`,n.area),s=e&&{...e,...t,sort:w()},c=JSON.stringify([i.map,i.version,s,C()]);if(c===m)return void k(o);m=c;let l=e=>{throw c===m&&(m=``,v=window.setTimeout(S.redraw,kg)),e},u=Object.values(t).some(e=>e!==null),[d,D]=s&&C()?await Promise.all([E(s)(0,null),u?g.listCount(i.map,p,s).then(e=>e.count):C()]).catch(l):[{rows:[],next:null},0];c===m&&([y,_]=[D,s],b.open(s&&E(s),d),x.show(D,w(),f(),s?`Nothing matches the filters, or nothing changed.`:`Choose a drive, or two times, to see what changed.`),x.choose(null,!1),h(),T(),k(!0))}async function O(e){return b.find(t=>t.id===e)??(_&&i?(await g.listCount(i.map,p,{..._,feature:e})).index:null)}function k(e){let t=r?.feature??null,i=t===null?null:b.find(e=>e.id===t);if(t===null||i!==null)return x.choose(i,e);e&&O(t).then(e=>t===r?.feature&&x.choose(e,!0),n.failed)}return{table:x,tab:S,pages:b,chooseShown:k,indexOf:O,size:()=>y??0,number:()=>y!==null&&S.visible?y:C()}}let m=()=>f[t.opened===`changes`?`changes`:`cones`];function h(){f.cones.tab.count(f.cones.number(),B()?`Cones`:`Objects`),f.changes.tab.count(f.changes.number())}return{show(t,n){[r,i]=[t,n],a=new Map(c().map(t=>[t.changeset_no,e(t)])),h();for(let{tab:e}of Object.values(f))e.redraw()},moved(){r?.inView&&m().tab.redraw()},choose(){let{tab:e,chooseShown:t}=m();e.visible&&t(o),o=!0},async next(e){let{pages:t,indexOf:n,size:i}=m(),a=r?.feature?await n(r.feature):null,o=a===null?e>0?0:i()-1:a+e;return o<0||o>=i()?null:await t.rowAt(o)??null}}}function Ng(e,t,n){return _(`button`,{type:`button`,class:`chip`,title:`List: ${t}`,data:{kind:e},onclick:()=>n(e)},ue(e),t)}var Pg=3e3,Fg=e=>e.toLocaleTimeString([],{hour:`2-digit`,minute:`2-digit`,second:`2-digit`});function Ig(e,t){let n=null,r=0,i=null,a=!1;function o(){n=g.events(e),n.addEventListener(`open`,()=>i=null),n.addEventListener(`changeset`,e=>{t.status(`live`,`New drives appear as soon as they are saved.`),t.newest(Number(e.data))}),n.addEventListener(`decision`,e=>t.decided(Number(e.data))),n.addEventListener(`base`,e=>t.base(e.data)),n.addEventListener(`trouble`,e=>t.status(`trouble`,e.data)),n.addEventListener(`error`,()=>{a||(i??=new Date,t.status(`waiting`,`No connection to the server since ${Fg(i)}: this is the map as it was then. Trying again …`),n?.readyState===EventSource.CLOSED&&(r=window.setTimeout(()=>void s(),Pg)))})}async function s(){await g.maps().catch(()=>void 0),a||o()}return o(),()=>{a=!0,window.clearTimeout(r),n?.close()}}var Lg=100,Rg=e=>({feature_id:e.feature_id??``,expected_version:e.version??0}),zg=(e,t,n)=>({text:t,done:n,request:(t,n)=>({kind:e,radius_m:1,...Rg(t),...n})}),Bg=(e,t)=>({text:e,done:t,request:(e,t)=>({kind:`approve`,...Rg(e),...t})}),Vg=(e,t,n)=>({text:t,done:n,request:(t,n)=>({kind:e,changeset_id:t.changeset_id??``,...n})}),Hg=e=>{let t=_e(e).label;return{text:t,done:t.toLowerCase(),request:(t,n)=>({kind:`classify`,category:e,...Rg(t),...n})}},Ug={held:{heading:`Drives on hold`,question:`May this drive change the map?`,accept:Vg(`accept`,`it may`,`accepted`),reject:Vg(`revert`,`leave it out`,`left out`)},removal:{heading:`Removed cones`,question:`Is this cone gone?`,accept:Bg(`it is gone`,`gone`),reject:zg(`pin`,`it still stands`,`still stands`)},move:{heading:`Moved by 1 m or more`,question:`Does the cone stand here now?`,accept:Bg(`it stands here`,`moved`),reject:zg(`suppress`,`no cone here`,`no cone`)},doubtful:{heading:`Uncertain cones`,question:`Does a cone stand here?`,accept:zg(`pin`,`it stands`,`stands`),reject:zg(`suppress`,`no cone here`,`no cone`)}};function Wg(e){let t=(t,n,r,i,{done:a,request:o})=>({key:n,verb:r,text:i,done:a,async write(n,r){let i=e.map(),{decision_id:a,versions_written:s}=await g.decide(i,o(t,n),r);return{undo:a?(e,t)=>g.decide(i,{kind:`withdraw`,decision_id:a,...e},t):null,changed:s>0}}});return{...e,id:`review`,name:`Review`,title:`Drives and changes to review, in images`,reason:`judged in the images`,async read(e,t){let{items:n,counts:r}=await g.review(e,t,Lg);return{items:n,total:Object.values(r).reduce((e,t)=>e+t,0)}},card:e=>({key:`${e.kind} ${e.feature_id??e.changeset_id??``} ${e.changeset_no}`,version:String(e.version),...Ug[e.kind],name:e.feature_id?M(e.feature_id):e.drive_id,isId:e.feature_id!==null,judged:``,about:e.checks[0]?.name??`${e.drive_id} · ${S(e.at,!1)} UTC`,why:[e.why,e.checks.filter(e=>e.figures).map(e=>`${e.name}: ${e.figures}`).join(`; `)].filter(Boolean).join(` Measured: `)}),answers:e=>[t(e,`A`,`Accept:`,Ug[e.kind].accept.text,Ug[e.kind].accept),t(e,`R`,`Reject:`,Ug[e.kind].reject.text,Ug[e.kind].reject)],classes:e=>e.feature_id===null||e.kind===`removal`?[]:[...pe.keys()].filter(t=>t!==`lane_marking`&&t!==e.category).map((n,r)=>t(e,String(r+1),_e(n).label,``,Hg(n))),refuses:t=>t.kind===`held`&&!e.decidesDrives()?`Decisions about whole drives require the role admin.`:null}}var Gg=[[`confirmed`,`C`,`Confirm:`,`it differs`],[`accepted`,`A`,`Accept:`,`it may stay so`],[`wrong`,`W`,`Wrong:`,`it does not differ`],[`open`,`O`,`Open again`,``]],Kg=e=>`${e.charAt(0).toUpperCase()}${e.slice(1)}`,qg=e=>`${Math.round(100*e)} %`;function Jg(e){let t=(t,[n,r,i,a])=>({key:r,verb:i,text:a,done:n,async write({decided_by:r,reason:i},a){let o=e.map(),s=(e,n,r,i)=>g.judge(o,t.difference_id,{verdict:e,decided_by:n,note:r},i);return await s(n,r,i,a),{undo:(e,n)=>s(t.verdict,e.decided_by,e.reason,n),changed:!1}}});return{...e,id:`differences`,name:`Plans`,title:`Work zones that differ from their plans, in images`,reason:``,async read(t){let{rows:n,plan_count:r}=await g.differences(t);e.rows(n,r);let i=n.filter(e=>e.rank!==null);return{items:i,total:i.length}},card:e=>({key:e.difference_id,version:JSON.stringify(Yg(e)),question:Kg(e.kind),heading:e.verdict===`open`?e.last_night?`Last night`:`Earlier`:`Judged`,name:Kg(e.kind),isId:!1,judged:e.verdict===`open`?``:e.verdict,about:`${Xg(e)} · ${e.text}`,why:Zg(e)}),answers:e=>Gg.filter(([t])=>t!==e.verdict).map(n=>t(e,n)),classes:()=>[],refuses:()=>null}}function Yg(e){let t=[e.last,e.first].flatMap(e=>e?.drive_uuid&&e.frame_index!==null&&e.frame_index!==void 0?[{drive_uuid:e.drive_uuid,frame_index:e.frame_index,drive_id:e.drive_id??``,at:e.at}]:[]);return t.filter((e,n)=>t.findIndex(t=>t.drive_uuid===e.drive_uuid)===n)}var Xg=e=>e.plan_id==null?`zone ${M(e.zone_id??``)}`:`plan ${e.plan_id}`;function Zg(e){return[`${Kg(Xg(e))}: ${e.text}${e.sigma==null?``:` (± ${e.sigma.toFixed(2)} m)`}.`,e.planned_from&&`Planned ${((e,t)=>`${e?S(e,!1):`…`} to ${t?S(t,!1):`open`} UTC`)(e.planned_from,e.planned_until)}.`,e.from_at&&e.zone_id&&`Seen from ${S(e.from_at,!1)} UTC, ${e.until_at?`gone at ${S(e.until_at,!1)} UTC`:e.passed_at?`last at ${S(e.passed_at,!1)} UTC`:`open`}.`,e.zone_id&&typeof e.coverage==`number`&&e.coverage<1&&`${e.coverage?`Drives passed ${qg(e.coverage)} of`:`No drive passed`} the place of the plan in its time.`,`Sure that it differs: ${O(e.confidence)}.`,e.verdict!==`open`&&`${Kg(e.verdict)}${e.decided_by?` by ${e.decided_by}`:``}${e.note?`: ${e.note}`:``}.`].filter(Boolean).join(` `)}var Qg=e=>`${Kg(e.kind)}${e.amount==null?``:` · ${e.amount.toFixed(+(e.unit===`h`))} ${e.unit}`}`,$g=500,e_=2,t_=!0;function n_(e,n,r,i){let a=e=>i.card(e).key,o=_(`b`,{class:`badge`,textContent:`…`,data:{count:``}}),s=_(`button`,{type:`button`,class:`link review-button`,title:i.title,data:{queue:i.id},onclick:()=>oe(!0)},_(`span`,{textContent:`${i.name} `}),o),c=_(`h2`,{tabIndex:-1}),l=_(`span`,{class:`review-progress`,role:`status`,aria:{live:`polite`}}),u=_(`p`,{class:`why`,tabIndex:0}),d=_(`div`,{class:`review-images`}),f=_(`ol`,{class:`review-items`,aria:{label:`Items to review`}}),p=_(`div`,{class:`review-buttons`}),m=_(`input`,{type:`text`,class:`review-note`,maxLength:500,autocomplete:`off`,placeholder:`Note for the next verdict (N)`,aria:{label:`Note for the next verdict`}}),h=_(`footer`,{class:`review-actions`},p,m),g=_(`section`,{class:`review`,hidden:!0,aria:{label:i.name}},_(`header`,{class:`review-head`},c,l,_(`span`,{class:`space`}),P(`Leave`,``,`Esc`,()=>oe(!1)),u),d,f,h),v=[],y=null,x=``,S=null,C=``,w=0,T=!1,D=null,O=``,k=new Map,A=new Map,M=Promise.resolve(),N=0;function P(e,t,n,r){return _(`button`,{type:`button`,onclick:r,title:n===`Esc`?`Back to the map (Esc)`:``},_(`b`,{textContent:e}),!!t&&_(`span`,{textContent:` ${t}`}),` `,_(`kbd`,{textContent:n}))}let ee=()=>`conetl ${i.id} ${r.map()}`,F=()=>{try{return new Set(JSON.parse(localStorage.getItem(ee())??`[]`))}catch{return new Set}},te=e=>t=>!e.has(a(t))&&!i.card(t).judged&&(k.get(a(t))?.state??`failed`)===`failed`,ne=()=>v.find(e=>a(e)===S);async function re(){let e=++w;x!==r.map()&&([x,v,y,S]=[r.map(),[],null,null],k.clear(),A.clear(),le());let t=[],n=new Set([...k].flatMap(([e,t])=>t.state===`saved`?e:[]));try{do{let n=await i.read(r.map(),t.length);if(e!==w)return;if(y=n.total,t.push(...n.items),!n.items.length)break}while(t.length<Math.min(y,$g));ie(t,n),C=``}catch(t){if(e!==w)return;C=j(t)}ne()||(S=null),le(),g.hidden||L(ne()??ae())}function ie(e,t){let n=new Map(e.map(e=>[a(e),e]));for(let[e,t]of k)t.state!==`failed`||n.has(e)||(k.delete(e),r.said(`“${t.text}” was not saved, and this item does not need a verdict any more. ${t.problem}`));let i=g.hidden?[]:v.flatMap(e=>n.get(a(e))??(k.has(a(e))?e:[])),o=new Set(i.map(a));for(let[e,r]of k)r.state===`saved`&&t.has(e)&&n.has(e)&&!N&&k.delete(e);v=[...i,...e.filter(e=>!o.has(a(e)))]}function I(){let e=v.findIndex(e=>a(e)===S);return[...v.slice(e+1),...v.slice(0,Math.max(e,0))].filter(te(F())).slice(0,e_)}let ae=()=>I()[0];function oe(t){t!==!g.hidden&&(g.hidden=!t,t?e.append(g):g.remove(),e.classList.toggle(`reviewing`,t),D=null,t&&n.dockIn(d),r.opened(t),t?(c.focus(),L(ne()??v.find(te(F()))??v[0])):(v=v.filter(e=>k.get(a(e))?.state!==`saved`),O=``,le(),s.focus()))}function L(e){e&&(S=a(e)),T=!1,le(),f.querySelector(`[aria-current="true"]`)?.scrollIntoView({block:`nearest`}),e&&O!==R(e)&&(O=R(e),i.show(e),ce(e))}let R=e=>`${a(e)} ${i.card(e).version}`,se=e=>{let t=R(e),n=A.get(t)??i.subject(e);return A.set(t,n),n.catch(()=>A.delete(t)),n};async function ce(e){try{let[t,r]=await se(e);if(a(e)!==S||g.hidden)return;let i=n.show(t,r,t_);le(),await i;for(let t of I())a(e)===S&&await n.preload(...await se(t),t_)}catch(t){a(e)===S&&(u.textContent=j(t))}}function le(){let e=F(),t=v.filter(te(e)).length,n=y===null?null:t+Math.max(y-v.length,0);if(o.textContent=n===null?C?`?`:`…`:n.toLocaleString(`en`),o.dataset.count=String(n??``),s.setAttribute(`aria-label`,`${i.name}: ${n===null?`number of items unknown`:E(n,`item`)}`),g.hidden)return;let r=v.flatMap((t,n)=>{let r=i.card(t),a=k.get(r.key),o=a?{saving:`${a.text}, saving …`,saved:`${a.text} ✓`,failed:`not saved`,withdrawing:`withdrawing …`}[a.state]:e.has(r.key)?`skipped`:r.judged&&`${r.judged} ✓`,s=_(`li`,{class:a?.state??``,data:{item:r.name}},_(`button`,{type:`button`,onclick:()=>L(t)},_(`b`,{class:r.isId?`mono`:``,textContent:r.name}),_(`i`,{textContent:o}),_(`small`,{textContent:r.about})));s.setAttribute(`aria-current`,String(r.key===S));let c=v[n-1];return c&&i.card(c).heading===r.heading?[s]:[_(`li`,{class:`heading`},_(`h3`,{textContent:r.heading})),s]});b(f,...r,!!C&&_(`li`,{class:`hint bad`,textContent:C}));let c=v.findIndex(e=>a(e)===S);b(l,c>=0&&`${(c+1).toLocaleString(`en`)} of ${v.length.toLocaleString(`en`)}`,n!==null&&_(`span`,{textContent:` · ${n.toLocaleString(`en`)} left`}),N>0&&` · saving ${N} …`),ue()}function ue(){let e=ne();if(d.hidden=m.hidden=!e,!e)return c.textContent=y===null?`Loading …`:`Nothing to review`,u.textContent=C,b(p,P(`Leave`,``,`Esc`,()=>oe(!1)));let t=i.card(e),n=k.get(t.key);if(c.textContent=t.question,u.textContent=t.why,m.hidden=!r.writable()||D!==null,D?.isConnected)return;let a=p.contains(document.activeElement),o=r.writable()?i.refuses(e):Dh.person()===null?"Read-only: decisions require `conetl view --decisions`.":"Read-only: decisions require the role review, and `conetl view --decisions`.";b(p,...D?[D]:o===null?T?me(e):n&&n.state!==`failed`?pe(n,e):fe(e,n):[_(`p`,{class:`hint`,textContent:o}),...de()]),a&&!D&&p.querySelector(`button`)?.focus()}let de=()=>[P(`Skip`,``,`S`,xe),P(`Back`,``,`B`,()=>Se(-1))],fe=(e,t)=>[...t?[_(`p`,{class:`hint bad`,role:`alert`,textContent:`“${t.text}” was not saved. ${t.problem}`})]:[],...i.answers(e).map(t=>P(t.verb,t.text,t.key,()=>ye(e,t))),...i.classes(e).length?[P(`Class …`,``,`C`,()=>he(!0))]:[],...de()],pe=(e,t)=>[_(`p`,{class:`hint`,textContent:e.state===`saved`?`Judged: ${e.text}. Saved.`:`Judged: ${e.text}. Saving …`}),...e.state===`saved`&&e.undo?[P(`Withdraw`,``,`W`,()=>z(t))]:[],P(`Next`,``,`S`,()=>L(ae())),P(`Back`,``,`B`,()=>Se(-1))],me=e=>[...i.classes(e).map(t=>P(t.verb,t.text,t.key,()=>ye(e,t))),P(`Cancel`,``,`C`,()=>he(!1))];function he(e){T=e,le()}function ge(e,t){let n=_(`input`,{type:`text`,name:`name`,required:!0,minLength:2,maxLength:80,autocomplete:`name`,placeholder:` `,value:Dh.name()}),r=_(`input`,{type:`password`,name:`token`,required:!0,autocomplete:`off`,placeholder:` `}),i=_(`form`,{class:`review-writer`},!!e&&_(`p`,{class:`hint bad`,role:`alert`,textContent:e}),Ih(`Your name`,n,`Visible to everyone who sees the map.`),Ih(`Writer token`,r,`In the file that conetl view names when it starts.`),_(`button`,{type:`submit`,class:`primary`,textContent:`Continue`}),_(`button`,{type:`button`,textContent:`Cancel`,onclick:()=>_e(null)}));return i.addEventListener(`submit`,e=>{e.preventDefault(),Dh.keep(n.value.trim(),r.value.trim()),_e(null),t()}),i}function _e(e){D?.remove(),D=e,le(),e?e.querySelector(`input:placeholder-shown`)?.focus():c.focus()}function ve(e){let t=m.value.trim();return m.value=``,{decided_by:Dh.name(),reason:t.length>2?t:e}}function ye(e,n){let r=Dh.token();if(r===null)return _e(ge(``,()=>ye(e,n)));let o=ve(i.reason),s={text:n.done,state:`saving`,problem:``,undo:null};k.set(a(e),s),be(async()=>{try{let{undo:e,changed:t}=await n.write(o,Dh.token()??r);s.undo=e,t&&A.clear(),s.state=`saved`}catch(r){if(Object.assign(s,{state:`failed`,problem:j(r)}),!(r instanceof t)||r.status!==401)return;Dh.forget(),k.delete(a(e)),L(e),_e(ge(s.problem,()=>ye(e,n)))}}),L(ae()??e)}function z(e){let t=k.get(a(e));if(!t?.undo||t.state!==`saved`)return;let{undo:n}=t,r=ve(`withdrawn in the review`);t.state=`withdrawing`,be(async()=>{try{await n(r,Dh.token()??``),k.delete(a(e)),A.clear(),y!==null&&(y+=1)}catch(e){t.state=`saved`,t.text+=` (not withdrawn: ${j(e)})`}}),le()}function be(e){N+=1,M=M.then(e).then(()=>{--N,le(),N||i.decided()})}function xe(){let e=ne();if(!e)return;let t=ae();k.has(a(e))||localStorage.setItem(ee(),JSON.stringify([...F(),a(e)].slice(-5e3))),L(t??e)}function Se(e){L(v[v.findIndex(e=>a(e)===S)+e]??ne())}function B(e){let t=[...g.querySelectorAll(`.review-buttons button, .review-head button`)].find(t=>t.querySelector(`kbd`)?.textContent?.toLowerCase()===e);return t?.click(),t!==void 0}return{id:i.id,button:s,load:()=>void re(),set:oe,get isOpen(){return!g.hidden},key(e,t){let r=e.key.toLowerCase();return t?(r===`escape`&&(D?_e(null):m.blur()),r===`escape`||r===`enter`&&e.target===m&&(m.blur(),!0)):r===`escape`?(T?he(!1):oe(!1),!0):r===`n`&&!m.hidden?(m.focus(),!0):r===`arrowdown`||r===`arrowup`?(Se(r===`arrowdown`?1:-1),!0):(r===` `||r===`enter`)&&e.target instanceof HTMLButtonElement?!1:B(r)||!`bc`.includes(r)&&n.key(e)}}}var r_={type:`change`},i_={type:`start`},a_={type:`end`},o_=new ka,s_=new Sa,c_=Math.cos(70*mr.DEG2RAD),l_=new q,u_=2*Math.PI,d_={NONE:-1,ROTATE:0,DOLLY:1,PAN:2,TOUCH_ROTATE:3,TOUCH_PAN:4,TOUCH_DOLLY_PAN:5,TOUCH_DOLLY_ROTATE:6},f_=1e-6,p_=class extends ml{constructor(e,t=null){super(e,t),this.state=d_.NONE,this.target=new q,this.cursor=new q,this.minDistance=0,this.maxDistance=1/0,this.minZoom=0,this.maxZoom=1/0,this.minTargetRadius=0,this.maxTargetRadius=1/0,this.minPolarAngle=0,this.maxPolarAngle=Math.PI,this.minAzimuthAngle=-1/0,this.maxAzimuthAngle=1/0,this.enableDamping=!1,this.dampingFactor=.05,this.enableZoom=!0,this.zoomSpeed=1,this.enableRotate=!0,this.rotateSpeed=1,this.keyRotateSpeed=1,this.enablePan=!0,this.panSpeed=1,this.screenSpacePanning=!0,this.keyPanSpeed=7,this.zoomToCursor=!1,this.autoRotate=!1,this.autoRotateSpeed=2,this.keys={LEFT:`ArrowLeft`,UP:`ArrowUp`,RIGHT:`ArrowRight`,BOTTOM:`ArrowDown`},this.mouseButtons={LEFT:Qe.ROTATE,MIDDLE:Qe.DOLLY,RIGHT:Qe.PAN},this.touches={ONE:$e.ROTATE,TWO:$e.DOLLY_PAN},this.target0=this.target.clone(),this.position0=this.object.position.clone(),this.zoom0=this.object.zoom,this._cursorStyle=`auto`,this._domElementKeyEvents=null,this._lastPosition=new q,this._lastQuaternion=new hr,this._lastTargetPosition=new q,this._quat=new hr().setFromUnitVectors(e.up,new q(0,1,0)),this._quatInverse=this._quat.clone().invert(),this._spherical=new al,this._sphericalDelta=new al,this._scale=1,this._panOffset=new q,this._rotateStart=new K,this._rotateEnd=new K,this._rotateDelta=new K,this._panStart=new K,this._panEnd=new K,this._panDelta=new K,this._dollyStart=new K,this._dollyEnd=new K,this._dollyDelta=new K,this._dollyDirection=new q,this._mouse=new K,this._performCursorZoom=!1,this._pointers=[],this._pointerPositions={},this._controlActive=!1,this._onPointerMove=h_.bind(this),this._onPointerDown=m_.bind(this),this._onPointerUp=g_.bind(this),this._onContextMenu=C_.bind(this),this._onMouseWheel=y_.bind(this),this._onKeyDown=b_.bind(this),this._onTouchStart=x_.bind(this),this._onTouchMove=S_.bind(this),this._onMouseDown=__.bind(this),this._onMouseMove=v_.bind(this),this._interceptControlDown=w_.bind(this),this._interceptControlUp=T_.bind(this),this.domElement!==null&&this.connect(this.domElement),this.update()}set cursorStyle(e){this._cursorStyle=e,e===`grab`?this.domElement.style.cursor=`grab`:this.domElement.style.cursor=`auto`}get cursorStyle(){return this._cursorStyle}connect(e){super.connect(e),this.domElement.addEventListener(`pointerdown`,this._onPointerDown),this.domElement.addEventListener(`pointercancel`,this._onPointerUp),this.domElement.addEventListener(`contextmenu`,this._onContextMenu),this.domElement.addEventListener(`wheel`,this._onMouseWheel,{passive:!1}),this.domElement.ownerDocument.addEventListener(`keydown`,this._interceptControlDown,{passive:!0,capture:!0}),this.domElement.style.touchAction=`none`}disconnect(){this.state=d_.NONE,this.domElement.removeEventListener(`pointerdown`,this._onPointerDown),this.domElement.ownerDocument.removeEventListener(`pointermove`,this._onPointerMove),this.domElement.ownerDocument.removeEventListener(`pointerup`,this._onPointerUp),this.domElement.removeEventListener(`pointercancel`,this._onPointerUp),this.domElement.removeEventListener(`wheel`,this._onMouseWheel),this.domElement.removeEventListener(`contextmenu`,this._onContextMenu),this.stopListenToKeyEvents(),this.domElement.ownerDocument.removeEventListener(`keydown`,this._interceptControlDown,{capture:!0}),this.domElement.ownerDocument.removeEventListener(`keyup`,this._interceptControlUp,{capture:!0}),this._controlActive=!1,this._pointers.length=0,this._pointerPositions={},this.domElement.style.touchAction=``,this.domElement.style.cursor=`auto`}dispose(){this.disconnect()}getPolarAngle(){return this._spherical.phi}getAzimuthalAngle(){return this._spherical.theta}getDistance(){return this.object.position.distanceTo(this.target)}listenToKeyEvents(e){e.addEventListener(`keydown`,this._onKeyDown),this._domElementKeyEvents=e}stopListenToKeyEvents(){this._domElementKeyEvents!==null&&(this._domElementKeyEvents.removeEventListener(`keydown`,this._onKeyDown),this._domElementKeyEvents=null)}saveState(){this.target0.copy(this.target),this.position0.copy(this.object.position),this.zoom0=this.object.zoom}reset(){this.target.copy(this.target0),this.object.position.copy(this.position0),this.object.zoom=this.zoom0,this.object.updateProjectionMatrix(),this.dispatchEvent(r_),this.update(),this.state=d_.NONE}pan(e,t){this._pan(e,t),this.update()}dollyIn(e){this._dollyIn(e),this.update()}dollyOut(e){this._dollyOut(e),this.update()}rotateLeft(e){this._rotateLeft(e),this.update()}rotateUp(e){this._rotateUp(e),this.update()}update(e=null){let t=this.object.position;l_.copy(t).sub(this.target),l_.applyQuaternion(this._quat),this._spherical.setFromVector3(l_),this.autoRotate&&this.state===d_.NONE&&this._rotateLeft(this._getAutoRotationAngle(e)),this.enableDamping?(this._spherical.theta+=this._sphericalDelta.theta*this.dampingFactor,this._spherical.phi+=this._sphericalDelta.phi*this.dampingFactor):(this._spherical.theta+=this._sphericalDelta.theta,this._spherical.phi+=this._sphericalDelta.phi);let n=this.minAzimuthAngle,r=this.maxAzimuthAngle;isFinite(n)&&isFinite(r)&&(n<-Math.PI?n+=u_:n>Math.PI&&(n-=u_),r<-Math.PI?r+=u_:r>Math.PI&&(r-=u_),n<=r?this._spherical.theta=Math.max(n,Math.min(r,this._spherical.theta)):this._spherical.theta=this._spherical.theta>(n+r)/2?Math.max(n,this._spherical.theta):Math.min(r,this._spherical.theta)),this._spherical.phi=Math.max(this.minPolarAngle,Math.min(this.maxPolarAngle,this._spherical.phi)),this._spherical.makeSafe(),this.enableDamping===!0?this.target.addScaledVector(this._panOffset,this.dampingFactor):this.target.add(this._panOffset),this.target.sub(this.cursor),this.target.clampLength(this.minTargetRadius,this.maxTargetRadius),this.target.add(this.cursor);let i=!1;if(this.zoomToCursor&&this._performCursorZoom||this.object.isOrthographicCamera)this._spherical.radius=this._clampDistance(this._spherical.radius);else{let e=this._spherical.radius;this._spherical.radius=this._clampDistance(this._spherical.radius*this._scale),i=e!=this._spherical.radius}if(l_.setFromSpherical(this._spherical),l_.applyQuaternion(this._quatInverse),t.copy(this.target).add(l_),this.object.lookAt(this.target),this.enableDamping===!0?(this._sphericalDelta.theta*=1-this.dampingFactor,this._sphericalDelta.phi*=1-this.dampingFactor,this._panOffset.multiplyScalar(1-this.dampingFactor)):(this._sphericalDelta.set(0,0,0),this._panOffset.set(0,0,0)),this.zoomToCursor&&this._performCursorZoom){let e=null;if(this.object.isPerspectiveCamera){let t=l_.length();e=this._clampDistance(t*this._scale);let n=t-e;this.object.position.addScaledVector(this._dollyDirection,n),this.object.updateMatrixWorld(),i=!!n}else if(this.object.isOrthographicCamera){let t=new q(this._mouse.x,this._mouse.y,0);t.unproject(this.object);let n=this.object.zoom;this.object.zoom=Math.max(this.minZoom,Math.min(this.maxZoom,this.object.zoom/this._scale)),this.object.updateProjectionMatrix(),i=n!==this.object.zoom;let r=new q(this._mouse.x,this._mouse.y,0);r.unproject(this.object),this.object.position.sub(r).add(t),this.object.updateMatrixWorld(),e=l_.length()}else console.warn(`WARNING: OrbitControls.js encountered an unknown camera type - zoom to cursor disabled.`),this.zoomToCursor=!1;e!==null&&(this.screenSpacePanning?this.target.set(0,0,-1).transformDirection(this.object.matrix).multiplyScalar(e).add(this.object.position):(o_.origin.copy(this.object.position),o_.direction.set(0,0,-1).transformDirection(this.object.matrix),Math.abs(this.object.up.dot(o_.direction))<c_?this.object.lookAt(this.target):(s_.setFromNormalAndCoplanarPoint(this.object.up,this.target),o_.intersectPlane(s_,this.target))))}else if(this.object.isOrthographicCamera){let e=this.object.zoom;this.object.zoom=Math.max(this.minZoom,Math.min(this.maxZoom,this.object.zoom/this._scale)),e!==this.object.zoom&&(this.object.updateProjectionMatrix(),i=!0)}return this._scale=1,this._performCursorZoom=!1,i||this._lastPosition.distanceToSquared(this.object.position)>f_||8*(1-this._lastQuaternion.dot(this.object.quaternion))>f_||this._lastTargetPosition.distanceToSquared(this.target)>f_?(this.dispatchEvent(r_),this._lastPosition.copy(this.object.position),this._lastQuaternion.copy(this.object.quaternion),this._lastTargetPosition.copy(this.target),!0):!1}_getAutoRotationAngle(e){return e===null?u_/60/60*this.autoRotateSpeed:u_/60*this.autoRotateSpeed*e}_getZoomScale(e){let t=Math.abs(e*.01);return .95**(this.zoomSpeed*t)}_rotateLeft(e){this._sphericalDelta.theta-=e}_rotateUp(e){this._sphericalDelta.phi-=e}_panLeft(e,t){l_.setFromMatrixColumn(t,0),l_.multiplyScalar(-e),this._panOffset.add(l_)}_panUp(e,t){this.screenSpacePanning===!0?l_.setFromMatrixColumn(t,1):(l_.setFromMatrixColumn(t,0),l_.crossVectors(this.object.up,l_)),l_.multiplyScalar(e),this._panOffset.add(l_)}_pan(e,t){let n=this.domElement;if(this.object.isPerspectiveCamera){let r=this.object.position;l_.copy(r).sub(this.target);let i=l_.length();i*=Math.tan(this.object.fov/2*Math.PI/180),this._panLeft(2*e*i/n.clientHeight,this.object.matrix),this._panUp(2*t*i/n.clientHeight,this.object.matrix)}else this.object.isOrthographicCamera?(this._panLeft(e*(this.object.right-this.object.left)/this.object.zoom/n.clientWidth,this.object.matrix),this._panUp(t*(this.object.top-this.object.bottom)/this.object.zoom/n.clientHeight,this.object.matrix)):(console.warn(`WARNING: OrbitControls.js encountered an unknown camera type - pan disabled.`),this.enablePan=!1)}_dollyOut(e){this.object.isPerspectiveCamera||this.object.isOrthographicCamera?this._scale/=e:(console.warn(`WARNING: OrbitControls.js encountered an unknown camera type - dolly/zoom disabled.`),this.enableZoom=!1)}_dollyIn(e){this.object.isPerspectiveCamera||this.object.isOrthographicCamera?this._scale*=e:(console.warn(`WARNING: OrbitControls.js encountered an unknown camera type - dolly/zoom disabled.`),this.enableZoom=!1)}_updateZoomParameters(e,t){if(!this.zoomToCursor)return;this._performCursorZoom=!0;let n=this.domElement.getBoundingClientRect(),r=e-n.left,i=t-n.top,a=n.width,o=n.height;this._mouse.x=r/a*2-1,this._mouse.y=-(i/o)*2+1,this._dollyDirection.set(this._mouse.x,this._mouse.y,1).unproject(this.object).sub(this.object.position).normalize()}_clampDistance(e){return Math.max(this.minDistance,Math.min(this.maxDistance,e))}_handleMouseDownRotate(e){this._rotateStart.set(e.clientX,e.clientY)}_handleMouseDownDolly(e){this._updateZoomParameters(e.clientX,e.clientY),this._dollyStart.set(e.clientX,e.clientY)}_handleMouseDownPan(e){this._panStart.set(e.clientX,e.clientY)}_handleMouseMoveRotate(e){this._rotateEnd.set(e.clientX,e.clientY),this._rotateDelta.subVectors(this._rotateEnd,this._rotateStart).multiplyScalar(this.rotateSpeed);let t=this.domElement;this._rotateLeft(u_*this._rotateDelta.x/t.clientHeight),this._rotateUp(u_*this._rotateDelta.y/t.clientHeight),this._rotateStart.copy(this._rotateEnd),this.update()}_handleMouseMoveDolly(e){this._dollyEnd.set(e.clientX,e.clientY),this._dollyDelta.subVectors(this._dollyEnd,this._dollyStart),this._dollyDelta.y>0?this._dollyOut(this._getZoomScale(this._dollyDelta.y)):this._dollyDelta.y<0&&this._dollyIn(this._getZoomScale(this._dollyDelta.y)),this._dollyStart.copy(this._dollyEnd),this.zoomToCursor&&(this._performCursorZoom=!0,this._dollyDirection.set(this._mouse.x,this._mouse.y,1).unproject(this.object).sub(this.object.position).normalize()),this.update()}_handleMouseMovePan(e){this._panEnd.set(e.clientX,e.clientY),this._panDelta.subVectors(this._panEnd,this._panStart).multiplyScalar(this.panSpeed),this._pan(this._panDelta.x,this._panDelta.y),this._panStart.copy(this._panEnd),this.update()}_handleMouseWheel(e){this._updateZoomParameters(e.clientX,e.clientY),e.deltaY<0?this._dollyIn(this._getZoomScale(e.deltaY)):e.deltaY>0&&this._dollyOut(this._getZoomScale(e.deltaY)),this.update()}_handleKeyDown(e){let t=!1;switch(e.code){case this.keys.UP:e.ctrlKey||e.metaKey||e.shiftKey?this.enableRotate&&this._rotateUp(u_*this.keyRotateSpeed/this.domElement.clientHeight):this.enablePan&&this._pan(0,this.keyPanSpeed),t=!0;break;case this.keys.BOTTOM:e.ctrlKey||e.metaKey||e.shiftKey?this.enableRotate&&this._rotateUp(-u_*this.keyRotateSpeed/this.domElement.clientHeight):this.enablePan&&this._pan(0,-this.keyPanSpeed),t=!0;break;case this.keys.LEFT:e.ctrlKey||e.metaKey||e.shiftKey?this.enableRotate&&this._rotateLeft(u_*this.keyRotateSpeed/this.domElement.clientHeight):this.enablePan&&this._pan(this.keyPanSpeed,0),t=!0;break;case this.keys.RIGHT:e.ctrlKey||e.metaKey||e.shiftKey?this.enableRotate&&this._rotateLeft(-u_*this.keyRotateSpeed/this.domElement.clientHeight):this.enablePan&&this._pan(-this.keyPanSpeed,0),t=!0}t&&(e.preventDefault(),this.update())}_handleTouchStartRotate(e){if(this._pointers.length===1)this._rotateStart.set(e.pageX,e.pageY);else{let t=this._getSecondPointerPosition(e),n=.5*(e.pageX+t.x),r=.5*(e.pageY+t.y);this._rotateStart.set(n,r)}}_handleTouchStartPan(e){if(this._pointers.length===1)this._panStart.set(e.pageX,e.pageY);else{let t=this._getSecondPointerPosition(e),n=.5*(e.pageX+t.x),r=.5*(e.pageY+t.y);this._panStart.set(n,r)}}_handleTouchStartDolly(e){let t=this._getSecondPointerPosition(e),n=e.pageX-t.x,r=e.pageY-t.y,i=Math.sqrt(n*n+r*r);this._dollyStart.set(0,i)}_handleTouchStartDollyPan(e){this.enableZoom&&this._handleTouchStartDolly(e),this.enablePan&&this._handleTouchStartPan(e)}_handleTouchStartDollyRotate(e){this.enableZoom&&this._handleTouchStartDolly(e),this.enableRotate&&this._handleTouchStartRotate(e)}_handleTouchMoveRotate(e){if(this._pointers.length==1)this._rotateEnd.set(e.pageX,e.pageY);else{let t=this._getSecondPointerPosition(e),n=.5*(e.pageX+t.x),r=.5*(e.pageY+t.y);this._rotateEnd.set(n,r)}this._rotateDelta.subVectors(this._rotateEnd,this._rotateStart).multiplyScalar(this.rotateSpeed);let t=this.domElement;this._rotateLeft(u_*this._rotateDelta.x/t.clientHeight),this._rotateUp(u_*this._rotateDelta.y/t.clientHeight),this._rotateStart.copy(this._rotateEnd)}_handleTouchMovePan(e){if(this._pointers.length===1)this._panEnd.set(e.pageX,e.pageY);else{let t=this._getSecondPointerPosition(e),n=.5*(e.pageX+t.x),r=.5*(e.pageY+t.y);this._panEnd.set(n,r)}this._panDelta.subVectors(this._panEnd,this._panStart).multiplyScalar(this.panSpeed),this._pan(this._panDelta.x,this._panDelta.y),this._panStart.copy(this._panEnd)}_handleTouchMoveDolly(e){let t=this._getSecondPointerPosition(e),n=e.pageX-t.x,r=e.pageY-t.y,i=Math.sqrt(n*n+r*r);this._dollyEnd.set(0,i),this._dollyDelta.set(0,(this._dollyEnd.y/this._dollyStart.y)**+this.zoomSpeed),this._dollyOut(this._dollyDelta.y),this._dollyStart.copy(this._dollyEnd);let a=(e.pageX+t.x)*.5,o=(e.pageY+t.y)*.5;this._updateZoomParameters(a,o)}_handleTouchMoveDollyPan(e){this.enableZoom&&this._handleTouchMoveDolly(e),this.enablePan&&this._handleTouchMovePan(e)}_handleTouchMoveDollyRotate(e){this.enableZoom&&this._handleTouchMoveDolly(e),this.enableRotate&&this._handleTouchMoveRotate(e)}_addPointer(e){this._pointers.push(e.pointerId)}_removePointer(e){delete this._pointerPositions[e.pointerId];for(let t=0;t<this._pointers.length;t++)if(this._pointers[t]==e.pointerId){this._pointers.splice(t,1);return}}_isTrackingPointer(e){for(let t=0;t<this._pointers.length;t++)if(this._pointers[t]==e.pointerId)return!0;return!1}_trackPointer(e){let t=this._pointerPositions[e.pointerId];t===void 0&&(t=new K,this._pointerPositions[e.pointerId]=t),t.set(e.pageX,e.pageY)}_getSecondPointerPosition(e){let t=e.pointerId===this._pointers[0]?this._pointers[1]:this._pointers[0];return this._pointerPositions[t]}_customWheelEvent(e){let t=e.deltaMode,n={clientX:e.clientX,clientY:e.clientY,deltaY:e.deltaY};switch(t){case 1:n.deltaY*=16;break;case 2:n.deltaY*=100}return e.ctrlKey&&!this._controlActive&&(n.deltaY*=10),n}};function m_(e){this.enabled!==!1&&(this._pointers.length===0&&(this.domElement.setPointerCapture(e.pointerId),this.domElement.ownerDocument.addEventListener(`pointermove`,this._onPointerMove),this.domElement.ownerDocument.addEventListener(`pointerup`,this._onPointerUp)),this._isTrackingPointer(e)||(this._addPointer(e),e.pointerType===`touch`?this._onTouchStart(e):this._onMouseDown(e),this._cursorStyle===`grab`&&(this.domElement.style.cursor=`grabbing`)))}function h_(e){this.enabled!==!1&&(e.pointerType===`touch`?this._onTouchMove(e):this._onMouseMove(e))}function g_(e){switch(this._removePointer(e),this._pointers.length){case 0:this.domElement.releasePointerCapture(e.pointerId),this.domElement.ownerDocument.removeEventListener(`pointermove`,this._onPointerMove),this.domElement.ownerDocument.removeEventListener(`pointerup`,this._onPointerUp),this.dispatchEvent(a_),this.state=d_.NONE,this._cursorStyle===`grab`&&(this.domElement.style.cursor=`grab`);break;case 1:let t=this._pointers[0],n=this._pointerPositions[t];this._onTouchStart({pointerId:t,pageX:n.x,pageY:n.y})}}function __(e){let t;switch(e.button){case 0:t=this.mouseButtons.LEFT;break;case 1:t=this.mouseButtons.MIDDLE;break;case 2:t=this.mouseButtons.RIGHT;break;default:t=-1}switch(t){case Qe.DOLLY:if(this.enableZoom===!1)return;this._handleMouseDownDolly(e),this.state=d_.DOLLY;break;case Qe.ROTATE:if(e.ctrlKey||e.metaKey||e.shiftKey){if(this.enablePan===!1)return;this._handleMouseDownPan(e),this.state=d_.PAN}else{if(this.enableRotate===!1)return;this._handleMouseDownRotate(e),this.state=d_.ROTATE}break;case Qe.PAN:if(e.ctrlKey||e.metaKey||e.shiftKey){if(this.enableRotate===!1)return;this._handleMouseDownRotate(e),this.state=d_.ROTATE}else{if(this.enablePan===!1)return;this._handleMouseDownPan(e),this.state=d_.PAN}break;default:this.state=d_.NONE}this.state!==d_.NONE&&this.dispatchEvent(i_)}function v_(e){switch(this.state){case d_.ROTATE:if(this.enableRotate===!1)return;this._handleMouseMoveRotate(e);break;case d_.DOLLY:if(this.enableZoom===!1)return;this._handleMouseMoveDolly(e);break;case d_.PAN:if(this.enablePan===!1)return;this._handleMouseMovePan(e)}}function y_(e){this.enabled!==!1&&this.enableZoom!==!1&&this.state===d_.NONE&&(e.preventDefault(),this.dispatchEvent(i_),this._handleMouseWheel(this._customWheelEvent(e)),this.dispatchEvent(a_))}function b_(e){this.enabled!==!1&&this._handleKeyDown(e)}function x_(e){switch(this._trackPointer(e),this._pointers.length){case 1:switch(this.touches.ONE){case $e.ROTATE:if(this.enableRotate===!1){this.state=d_.NONE;break}this._handleTouchStartRotate(e),this.state=d_.TOUCH_ROTATE;break;case $e.PAN:if(this.enablePan===!1){this.state=d_.NONE;break}this._handleTouchStartPan(e),this.state=d_.TOUCH_PAN;break;default:this.state=d_.NONE}break;case 2:switch(this.touches.TWO){case $e.DOLLY_PAN:if(this.enableZoom===!1&&this.enablePan===!1)return;this._handleTouchStartDollyPan(e),this.state=d_.TOUCH_DOLLY_PAN;break;case $e.DOLLY_ROTATE:if(this.enableZoom===!1&&this.enableRotate===!1)return;this._handleTouchStartDollyRotate(e),this.state=d_.TOUCH_DOLLY_ROTATE;break;default:this.state=d_.NONE}break;default:this.state=d_.NONE}this.state!==d_.NONE&&this.dispatchEvent(i_)}function S_(e){switch(this._trackPointer(e),this.state){case d_.TOUCH_ROTATE:if(this.enableRotate===!1)return;this._handleTouchMoveRotate(e),this.update();break;case d_.TOUCH_PAN:if(this.enablePan===!1)return;this._handleTouchMovePan(e),this.update();break;case d_.TOUCH_DOLLY_PAN:if(this.enableZoom===!1&&this.enablePan===!1)return;this._handleTouchMoveDollyPan(e),this.update();break;case d_.TOUCH_DOLLY_ROTATE:if(this.enableZoom===!1&&this.enableRotate===!1)return;this._handleTouchMoveDollyRotate(e),this.update();break;default:this.state=d_.NONE}}function C_(e){this.enabled!==!1&&e.preventDefault()}function w_(e){e.key===`Control`&&(this._controlActive=!0,this.domElement.ownerDocument.addEventListener(`keyup`,this._interceptControlUp,{passive:!0,capture:!0}))}function T_(e){e.key===`Control`&&(this._controlActive=!1,this.domElement.ownerDocument.removeEventListener(`keyup`,this._interceptControlUp,{passive:!0,capture:!0}))}var E_=40,D_=250,[O_,k_]=[.25,.02],A_=.6;function j_(e,t){let n=Object.assign(new Fr(1,1,{samples:4,colorSpace:Cn,internalFormat:`RGBA8`}),{isXRRenderTarget:!0}),r=new Ha(new Qs(2,2),new uc({vertexShader:`varying vec2 vAt; void main() { vAt = uv; gl_Position = vec4(position.xy, 0.0, 1.0); }`,fragmentShader:`uniform sampler2D picture; varying vec2 vAt; void main() { gl_FragColor = vec4(texture2D(picture, vAt).rgb, 1.0); }`,uniforms:{picture:{value:n.texture}},depthTest:!1,depthWrite:!1}));r.frustumCulled=!1;let[i,a]=[new Lc,new K],o=!1,s=!0,c=O_,l=0,u=0,d=0,f=0;function p(){let e=performance.now(),t=e-l;if(l=e,!o)return void(u=0);let n=Math.min(u,t);u=t,n>E_*1.2?c=Math.max(k_,c*Math.max(E_/n,.2)):t<E_*.8&&(c=Math.min(1,c*1.15)),s||=c<A_}return{moved(){o||(s=c<A_),o=!0,window.clearTimeout(d),window.cancelAnimationFrame(f),d=window.setTimeout(()=>{f=window.requestAnimationFrame(()=>{o=!1,t()})},D_)},adapt:p,get share(){return o?c:1},get plain(){return o&&s},draw(t){if(o&&s)return t();e.getDrawingBufferSize(a),n.setSize(a.x,a.y),e.setRenderTarget(n),t(),e.setRenderTarget(null),e.render(r,i)}}}var M_=42,N_=Math.tan(M_*Math.PI/360),P_=.001,F_=.95,I_=2e3,[L_,R_]=[.6,2e6],z_=10,B_=60,V_=12,H_=e=>e.set(e.x,e.z,-e.y),U_=e=>e.set(e.x,-e.z,e.y);function W_(e){let t=new Df({powerPreference:`high-performance`});t.debug.checkShaderErrors=!1,t.setPixelRatio(Math.min(window.devicePixelRatio,2));let n=t.domElement;n.tabIndex=0,n.setAttribute(`aria-label`,`3D map. Arrow keys pan, plus and minus zoom, Home shows everything.`);let r=_(`span`),i=_(`i`),a=_(`button`,{class:`north`,type:`button`,title:`Turn north up`,aria:{label:`Turn north up`},textContent:`N`});e.append(n,_(`div`,{class:`scalebar`},i,r),a);let o=new bi;o.background=new Y(ip().background);let s=new Vc(M_,1,.1,5e3),c=new Hc;c.far=2*I_;let l=!1,u=!1;s.up.set(0,0,1),s.position.set(0,-30,20);let d=new p_(s,n);d.enableDamping=!1,d.zoomToCursor=!0,d.minDistance=L_,d.maxDistance=R_;let f=Y_(ip().gridMinor),p=Y_(ip().gridMajor);o.add(f,p),cp(()=>{o.background.set(ip().background),f.material.color.set(ip().gridMinor),p.material.color.set(ip().gridMajor),E()});let m=0,h=``,g=[],v=[],y=null,b=1,x=!1,S=j_(t,()=>E()),C=!1,w=!1,T=0;function E(){!C&&w&&(C=!0,requestAnimationFrame(()=>{C=!1,D(),x=!0,S.adapt(),O(s.position.distanceTo(d.target));for(let e of g)e();x=!1,S.draw(y??(()=>t.render(o,se.camera))),T+=1,n.dataset.frames=String(T)}))}function D(){let e=s.position.distanceTo(d.target);s.near=Math.max(e/500,.05),s.far=e*40+500,s.updateProjectionMatrix(),s.updateMatrixWorld();let t=e*N_;[c.top,c.bottom,c.right,c.left]=[t,-t,t*s.aspect,-t*s.aspect];let n=A();c.up.set(-Math.sin(n),Math.cos(n),0),c.position.set(d.target.x,d.target.y,m+I_),c.lookAt(d.target.x,d.target.y,m),c.updateProjectionMatrix(),c.updateMatrixWorld()}function O(e){let t=q_(e/12);b=t;let n=[d.target.x,d.target.y].map(e=>Math.round(e/(t*10))*t*10),o=`${t} ${n.join(` `)} ${m}`;o!==h&&(h=o,X_(f,p,n,t,m));let c=F(s.position.distanceTo(d.target)),l=q_(90/c);i.style.width=`${l*c}px`,r.textContent=`${J_(l)}${f.visible?` · grid ${J_(t)}`:``}`,a.style.transform=`rotate(${A()}rad)`}let k=()=>H_(s.position.clone().sub(d.target)),A=()=>new al().setFromVector3(k()).theta;function j(){let e=new al().setFromVector3(k()),t=d.target;return[t.x,t.y,t.z,e.theta,e.phi,e.radius]}function M([e,t,n,r,i,a]){d.target.set(e,t,n);let o=new al(a,i,r).makeSafe();s.position.copy(U_(new q().setFromSpherical(o)).add(d.target)),d.update(),P()}function N(e){let t=(e,t,n)=>Math.max(e,t-e)/n;if(s.zoom=e?Math.min(N_*s.aspect/t(e.cx_px,e.width_px,e.fx_px),N_/t(e.cy_px,e.height_px,e.fy_px)):1,!e)return E();let n=e.map_R_camera.map(e=>-e[2]),{theta:r,phi:i}=new al().setFromVector3(H_(new q(...n))),a=Math.min(i,d.maxPolarAngle),o=U_(new q().setFromSphericalCoords(z_,a,r));M([e.xyz_m[0]-o.x,e.xyz_m[1]-o.y,e.xyz_m[2]-o.z,r,a,z_])}function P(){let e=j();S.moved();for(let t of v)t(e);E()}function ee(e){if(!e.length)return;s.zoom=1;let[,,,t,n]=j(),r=U_(new q().setFromSphericalCoords(1,n,t)),i=new q(0,0,1).cross(r).normalize(),a=[i,r.clone().cross(i),r],o=e.map(e=>a.map(t=>new q(...e).dot(t))),c=a.map((e,t)=>(G_(o.map(e=>e[t]??0))+K_(o.map(e=>e[t]??0)))/2),l=N_*.8,d=l*s.aspect/(u?2:1),[f=0,p=0,m=0]=c,h=Math.max(4,K_(o.map(([e=0,t=0,n=0])=>n-m+Math.max(Math.abs(e-f)/d,Math.abs(t-p)/l)))),g=a.reduce((e,t,n)=>e.addScaledVector(t,c[n]??0),new q);M([g.x,g.y,g.z,t,n,h])}function F(e){let t=l?s.position.distanceTo(d.target):Math.max(e,.05);return n.clientHeight*(l?1:s.zoom)/(2*N_*t)}let te=new q;function ne([e,t,r],i,a){te.set(e,t,r+i/2).applyMatrix4(se.camera.matrixWorldInverse);let o=-te.z;if(o<-i)return!1;let s=F(o);if(i*s<a)return!1;let c=2*i;return Math.abs(te.x)*s<n.clientWidth/2+c*s&&Math.abs(te.y)*s<n.clientHeight/2+c*s}function re(e){let[t,n,r,i,a,o]=j(),s=e.shiftKey,c=o*.08,u=[-Math.sin(i),Math.cos(i)],d=(e,s)=>M([t+c*(e*u[1]+s*u[0]),n+c*(s*u[1]-e*u[0]),r,i,a,o]);switch(e.key){case`ArrowLeft`:return s?M([t,n,r,i-.1,a,o]):d(-1,0),!0;case`ArrowRight`:return s?M([t,n,r,i+.1,a,o]):d(1,0),!0;case`ArrowUp`:return s&&!l?M([t,n,r,i,Math.max(a-.08,.01),o]):d(0,1),!0;case`ArrowDown`:return s&&!l?M([t,n,r,i,Math.min(a+.08,1.55),o]):d(0,-1),!0;case`+`:case`=`:return M([t,n,r,i,a,Math.max(o/1.2,L_)]),!0;case`-`:case`_`:return M([t,n,r,i,a,Math.min(o*1.2,R_)]),!0;default:return!1}}function ie(){let{clientWidth:n,clientHeight:r}=e;n&&r&&(t.setSize(n,r),s.aspect=n/r,E())}function I(){let[e,t]=l?[Qe.PAN,Qe.ROTATE]:[Qe.ROTATE,Qe.PAN];d.mouseButtons={LEFT:e,MIDDLE:Qe.DOLLY,RIGHT:t},d.touches=l?{ONE:$e.PAN,TWO:$e.DOLLY_ROTATE}:{ONE:$e.ROTATE,TWO:$e.DOLLY_PAN},[d.minPolarAngle,d.maxPolarAngle]=l?[P_,P_]:[0,Math.PI/2-.01]}n.addEventListener(`wheel`,e=>{if(!l)return;e.preventDefault(),e.stopImmediatePropagation();let[t,n,r,i,a,o]=j(),s=e.deltaMode===WheelEvent.DOM_DELTA_LINE?16:1,c=Math.min(Math.max(o*Math.exp(Math.min(Math.max(e.deltaY*s,-300),300)*.0018),L_),R_),u=oe(e.offsetX,e.offsetY)??[t,n];M([u[0]+(t-u[0])*c/o,u[1]+(n-u[1])*c/o,r,i,a,c])},{passive:!1,capture:!0});let ae=new q;function oe(e,t){if(x||D(),ae.set(R(e)/n.clientWidth*2-1,1-t/n.clientHeight*2,.5).unproject(se.camera),l)return[ae.x,ae.y,m];ae.sub(s.position);let r=(m-s.position.z)/ae.z;return r>0&&Number.isFinite(r)?[s.position.x+r*ae.x,s.position.y+r*ae.y,m]:null}let L=()=>u?n.clientWidth/4:0,R=e=>e+(e<n.clientWidth/2?1:-1)*L();d.addEventListener(`change`,P),new ResizeObserver(ie).observe(e),ie();let se={scene:o,canvas:n,renderer:t,quality:S,draw:E,fit:ee,setPose:M,key:re,sees:ne,groundAt:oe,pixelsAtDepth:F,lookFrom:N,unsplit:R,halfShift:L,get camera(){return l?c:s},get plan(){return l},get ground(){return m},get gridStep(){return b},pose:j,setPlan(e,t=!1){if(e===l)return;let[r,i,a,o,,s]=j(),c=oe(n.clientWidth/2,n.clientHeight/2)??[r,i,a];l=e,I(),t?E():M([...c,e?0:o,e?P_:F_,s])},setSplit(e){u=e,d.zoomToCursor=!e},showGrid(e){f.visible=p.visible=e,E()},setRender(e){y=e,E()},start(){w=!0,E()},warm:()=>void t.compile(o,se.camera),beforeDraw:e=>void g.push(e),onCamera:e=>void v.push(e),northUp(){let[e,t,n,,r,i]=j();M([e,t,n,0,r,i])},lookAt(e,t){s.zoom=1;let[,,,n,r]=j();M([...e,n,r,t])},setGround(e){m=e,E()},project(e){let t=new q(...e).project(se.camera);if(t.z>1||t.z<-1)return null;let r=(t.x+1)/2*n.clientWidth+L();return u&&r<n.clientWidth/2?null:[r,(1-t.y)/2*n.clientHeight]}};return I(),a.addEventListener(`click`,()=>se.northUp()),se}var G_=e=>e.reduce((e,t)=>Math.min(e,t),1/0),K_=e=>e.reduce((e,t)=>Math.max(e,t),-1/0);function q_(e){let t=10**Math.floor(Math.log10(Math.max(e,.001))),n=e/t;return t*(n>=5?5:n>=2?2:1)}var J_=e=>e>=1e3?`${e/1e3} km`:e<.995?`${Math.round(e*100)} cm`:`${e} m`;function Y_(e){let t=new bo(new ma,new so({color:e,depthWrite:!1}));return t.renderOrder=-1,t.frustumCulled=!1,t}function X_(e,t,n,r,i){let a=[[],[]],o=B_*r,s=V_*r;for(let e=-60;e<=B_;e++){let t=a[+(e%10==0)],[c,l]=[n[0]+e*r,n[1]+e*r];for(let e=-o;e<o;e+=s)t.push(c,n[1]+e,i,c,n[1]+e+s,i),t.push(n[0]+e,l,i,n[0]+e+s,l,i)}for(let[n,r]of[[e,a[0]],[t,a[1]]])n.geometry.dispose(),n.geometry=new ma().setAttribute(`position`,new na(r,3))}var Z_=200;function Q_(e,t){let n=[],r=-1,i=0,a=0,o=_(`div`,{class:`search-list`,id:`search-list`,role:`listbox`,hidden:!0,aria:{label:`Search results`}}),s=_(`p`,{class:`search-status hint`,role:`status`,hidden:!0}),c=_(`div`,{class:`search-popup`,hidden:!0},s,o),l=_(`input`,{id:`search`,type:`search`,placeholder:`Search cone, drive, date, town, coordinates`,autocomplete:`off`,spellcheck:!1,maxLength:100,role:`combobox`,aria:{label:`Search for the id of a cone, a drive, a date, a town or coordinates`,expanded:`false`,controls:`search-list`,autocomplete:`list`}}),u=_(`form`,{class:`search`,role:`search`},l,_(`kbd`,{textContent:`/`}),c);e.append(u),l.addEventListener(`input`,()=>{if(window.clearTimeout(i),!l.value.trim())return d();i=window.setTimeout(()=>void h(!1),Z_)}),u.addEventListener(`submit`,e=>{e.preventDefault(),window.clearTimeout(i);let t=n[r];t&&!c.hidden?f(t):h(!0)}),l.addEventListener(`keydown`,e=>{if(e.key===`Escape`)return d();let t=e.key===`ArrowDown`?1:e.key===`ArrowUp`?-1:0;t&&n.length&&(e.preventDefault(),c.hidden=!1,m((r+t+n.length)%n.length))}),u.addEventListener(`focusout`,e=>{e.relatedTarget instanceof Node&&u.contains(e.relatedTarget)||d()});function d(){a+=1,c.hidden=!0,n=[],r=-1,l.setAttribute(`aria-expanded`,`false`),l.removeAttribute(`aria-activedescendant`)}function f(e){d(),l.blur(),e.run()}function p(e,t=!1){c.hidden=!1,s.hidden=!e,s.textContent=e,s.classList.toggle(`bad`,t)}function m(e){r=e,o.querySelectorAll(`[role=option]`).forEach((t,n)=>{t.setAttribute(`aria-selected`,String(n===e)),n===e&&t.scrollIntoView({block:`nearest`})}),e>=0&&l.setAttribute(`aria-activedescendant`,`search-option-${e}`)}async function h(e){let r=l.value.trim(),i=++a;if(r)try{let o=await t.search(r);if(i!==a)return;if(n=y(o),e&&n.length===1&&n[0])return f(n[0]);g(r,o.truncated)}catch(e){if(i!==a)return;n=[],b(o),p(j(e),!0)}}function g(e,t){let r=[...new Set(n.map(e=>e.group))];b(o,...r.map((e,t)=>_(`div`,{role:`group`,aria:{labelledby:`search-group-${t}`}},_(`div`,{class:`search-group`,id:`search-group-${t}`,textContent:e,role:`presentation`}),...n.flatMap((t,n)=>t.group===e?[v(t,n)]:[])))),o.hidden=!n.length,l.setAttribute(`aria-expanded`,String(n.length>0)),p(n.length?t?`There are more results: type more characters.`:``:`Nothing found for “${e}”. Try the first characters of a cone's id, a drive, a date (2026-03-02), a town or coordinates (easting northing, or latitude, longitude).`),m(n.length?0:-1)}function v(e,t){let n=_(`div`,{class:`search-option`,role:`option`,id:`search-option-${t}`,aria:{selected:`false`}},_(`span`,{textContent:e.text}),_(`small`,{textContent:e.detail}));return n.addEventListener(`pointerdown`,e=>e.preventDefault()),n.addEventListener(`click`,()=>f(e)),n}let y=e=>[...e.feature_ids.map(e=>({group:`Cones`,text:M(e),detail:e,run:()=>t.select(e)})),...e.drives.map(e=>({group:e.kind===`drive`?`Drives`:`Imported maps`,text:e.drive_id,detail:`${S(e.captured_from)} UTC`,run:()=>t.showChangeset(e.changeset_no)})),...e.towns.map(e=>({group:`Towns`,text:e.label,detail:$_(e),run:()=>t.flyTo(e)})),...e.positions.map(e=>({group:`Coordinates`,text:$_(e),detail:e.label,run:()=>t.flyTo(e)}))];return{focus(){l.focus(),l.select()}}}var $_=({lat_lon_deg:e})=>e?`${e[0].toFixed(6)}, ${e[1].toFixed(6)}`:`outside the map's CRS`;function ev(e,t,n){let r=null,i=_(`button`,{type:`button`,class:`found-pin`,hidden:!0,title:`Search result: click to remove the marker`,aria:{label:`Remove the marker`},onclick:n});return t.append(i),e.beforeDraw(()=>{let t=r&&e.project(r);i.hidden=!t,t&&(i.style.transform=`translate(${t[0]}px, ${t[1]}px)`)}),t=>{r===t||r&&t&&r.every((e,n)=>e===t[n])||(r=t,i.hidden=!t,e.draw())}}var tv=e=>`±${k(Math.sqrt(e))}`,[nv,rv]=[`Existence probability`,`One standard deviation (sigma)`],iv=({history:e,reached:t})=>e.filter(t).at(-1);function av(e,t){let n=_(`header`,{}),r=_(`div`,{}),i=_(`div`,{}),a=_(`div`,{}),o=_(`section`,{class:`decide-section`},_(`h3`,{textContent:`Decision`}),i,a),s=Fh(a),c=_(`section`,{}),l=_(`section`,{class:`panel-images`,aria:{label:`Images`}}),u=_(`div`,{}),d=_(`div`,{class:`panel-scroll`},l,u,r,o,c);e.append(n,d);function f(e,...r){let i=_(`button`,{type:`button`,class:`link`,textContent:`Copy id`});i.addEventListener(`click`,()=>{navigator.clipboard.writeText(e).then(()=>i.textContent=`Copied`,()=>i.textContent=`Not allowed by the browser`)}),b(n,_(`div`,{class:`panel-title`},...r,_(`h2`,{class:`mono`,textContent:M(e),title:e}),i,_(`button`,{type:`button`,class:`link`,textContent:`Centre`,onclick:()=>t.centre()})),_(`button`,{type:`button`,class:`close`,textContent:`×`,title:`Close (Esc)`,aria:{label:`Close`},onclick:()=>t.close()}))}function p(t,n,i){e.hidden=!1,f(t),o.hidden=!0,b(r),b(u,_(`p`,{class:`hint ${i}`,textContent:n})),b(c)}function m(t){e.hidden=!1;let n=t.history[0];if(!n)return;let i=iv(t),a=t.kind??i?.kind,o=Oh(t.decisions?.decisions??[],t.id,t.history.at(-1)?.xyz_m,!!n.marking);f(t.id,a?_(`span`,{class:`chip kind`},ue(a),L[a].label):_(`span`,{class:`chip kind`,textContent:`not on the map yet`}),...o.some(e=>e.kind===`pin`)?[_(`span`,{class:`chip pinned`,textContent:`pinned`})]:[]),b(u,i&&ov(i)),b(r),i?h(t,i):b(u,_(`p`,{class:`notice`,textContent:`Not on the map yet: ${n.drive_id}, recorded ${T(n.captured_from)}, added it.`})),g(t),v(t,i)}function h(e,n){let i=$h(n.cov_m2),a=_(`select`,{aria:{label:`Scale of the drawn ellipse`}},_(`option`,{value:`auto`,textContent:`${tg(i)}× (auto)`}),...[1,10,100].map(e=>_(`option`,{value:String(e),textContent:`${e}×`})));a.value=e.factor===null?`auto`:String(e.factor),a.addEventListener(`change`,()=>t.setFactor(a.value===`auto`?null:Number(a.value)));let o=_(`span`,{class:`meter`},_(`i`));o.firstElementChild.style.width=`${n.existence_probability*100}%`;let s=n.marking,[c,l,u]=n.map_xyz_m.map(e=>e.toFixed(3));b(r,se(n.kind)&&_(`p`,{class:`hint`,textContent:`Last values before it left the map:`}),_(`dl`,{},...sv(`Class`,_e(n.category).label),...sv(`Position`,_(`span`,{class:`mono`,textContent:`${c} E`}),_(`span`,{class:`mono`,textContent:`${l} N`}),_(`small`,{textContent:`EPSG:${e.srid}, ${s?`middle of this stretch`:`foot centre`}`})),...sv(`Height`,_(`span`,{class:`mono`,textContent:`${u} m`}),_(`small`,{textContent:`ellipsoidal`})),...sv(`Accuracy`,_(`span`,{title:`${rv}: ${[0,3,5].map(e=>Math.sqrt(n.cov_m2[e]??0).toFixed(3)).join(`, `)} m`,textContent:`${tv(n.cov_m2[0])} east, ${tv(n.cov_m2[3])} north, ${tv(n.cov_m2[5])} up`})),...s?cv(s):sv(`95 % semi-axes`,_(`span`,{class:`mono`,textContent:`${i.major_m.toFixed(3)} × ${i.minor_m.toFixed(3)} m`}),_(`small`,{},`ellipse drawn at `,a)),...sv(`Sure it stands`,o,_(`span`,{title:`${nv} ${D(n.existence_probability)}`,textContent:O(n.existence_probability)})),...sv(`Evidence`,_(`span`,{textContent:lv(n)}),_(`small`,{textContent:`${E(n.observation_count,`observation`)} in total`})),...n.object_height_m===null?[]:sv(`Object height`,_(`span`,{class:`mono`,textContent:`${n.object_height_m.toFixed(3)} ± ${(n.object_height_sigma_m??0).toFixed(3)} m`})),...sv(`First, last seen`,_(`span`,{textContent:T(n.first_seen_at,!1)}),_(`span`,{textContent:T(n.last_seen_at,!1)}))))}function g({id:e,map:n,history:r,decisions:a}){let c=r.at(-1);if(o.hidden=a===null||!c||!a.writable&&!Oh(a.decisions,e,c.xyz_m,!!c.marking).length,!a||!c)return;let l=Oh(a.decisions,e,c.xyz_m,!!c.marking);if(b(i,...l.map(Ph)),!a.writable)return s.show(`${e} reading`,[],{map:n,changed:()=>void 0});let u=ye(c.category),d=e=>l.some(t=>t.kind===e),f={map:n,changed:()=>t.decided()};s.show(`${e} ${c.version} ${l.map(e=>e.decision_id).join(` `)}`,[...d(`suppress`)||se(c.kind)?[]:[kh(`suppress`,e,c.version,u)],...d(`pin`)||d(`suppress`)?[]:[kh(`pin`,e,c.version,u)],...l.map(jh)],f)}function v(e,n){b(c,_(`h3`,{textContent:`History, ${A(e.known)}`}),_(`ol`,{class:`history`},...e.history.map(e=>_(`li`,{class:e===n?`chosen`:``},_(`button`,{type:`button`,title:e.why,onclick:()=>t.showChangeset(e.changeset_no)},ue(e.kind),_(`span`,{},_(`b`,{textContent:L[e.kind].label}),e.kind===`moved`&&e.shift_m!==null&&` by ${e.shift_m.toFixed(3)} m`,dv(e),e.kind===`missed`?uv(e):` · version ${e.version}`,_(`small`,{},`${T(e.changed_at)} · `,_(`span`,{class:`together`,textContent:e.drive_id})),_(`small`,{title:`${nv} ${D(e.existence_probability)}`,textContent:`sure it stands: ${O(e.existence_probability)} · ${E(e.observation_count,`observation`)} · ${tv((e.cov_m2[0]+e.cov_m2[3])/2)}`})))))))}function y(){e.hidden=!0}return{images:l,show:m,hide:y,loading:e=>p(e,`Loading the history …`,`loading`),failed:(e,t)=>p(e,j(t),`bad`)}}function ov(e){return _(`p`,{class:se(e.kind)||e.kind===`missed`?`why gone`:`why`,textContent:e.why})}function sv(e,...t){return[_(`dt`,{textContent:e}),_(`dd`,{},...t)]}var cv=e=>[...sv(`Accuracy across`,_(`span`,{title:rv,textContent:`±${k(e.sigma_lateral_m)}`}),_(`small`,{textContent:`largest along the line`})),...sv(`Paint`,_(`span`,{textContent:Nm(e)})),...sv(`Width`,_(`span`,{class:`mono`,textContent:`${e.width_m.toFixed(3)} ± ${e.width_sigma_m.toFixed(3)} m`})),...sv(`Length`,_(`span`,{class:`mono`,textContent:`${Pm(e.line_m).toFixed(2)} m`}),_(`small`,{textContent:`of this stretch`}))];function lv(e){let t=e.missed_count?[`not observed by ${E(e.missed_count,`drive`)}`]:[];return[`observed by ${e.seen_count?E(e.seen_count,`drive`):`no drive`}`,...t].map(e=>e.replaceAll(` `,`\xA0`)).join(`, `)}var uv=e=>e.frames_empty?` in ${E(e.frames_empty,`frame pair`)}`:``;function dv(e){return e.other_feature_id===null?``:` ${e.kind===`merged`?`into`:`from`} ${M(e.other_feature_id)}`}async function fv(e,t,n){let[{history:r},{sightings:i}]=await Promise.all([g.history(e,t,null),g.sightings(e,t)]),a=r.filter(e=>e.changeset_no===n).at(-1)??r.at(-1);if(!a)throw Error(`The history of ${M(t)} is empty.`);return[pv(e,t,r,a,i),null]}function pv(e,t,n,r,i){let a=r.kind===`moved`?n[n.indexOf(r)-1]??null:null;return{map:e,id:t,title:M(t),why:r.why,now:r,isLast:r===n.at(-1),before:a,sightings:i}}function mv(e,t,n,r,i){let a=null,o=0,s=``,c=null,l=av(e,{close:()=>void d(null),showChangeset:i.showChangeset,setFactor:e=>{a&&={...a,factor:e},m()},centre:y,decided:i.decided}),u=()=>$p(i.state(),i.timeline()?.changesets??[]);async function d(e,t=!1){let n=++o,r=i.state();if(e!==r.feature&&(r.image=null),r.feature=e,i.writeAddress(),i.chosen(e),e===null){f(),m();return}let s=r.map;a?.id!==e&&(a=null,l.loading(e),m());try{let{reached:r,known:c}=u(),{history:l}=await g.history(s,e,c);if(n!==o)return;a={id:e,map:s,srid:i.timeline()?.srid??0,history:l,known:c,sightings:a?.sightings??null,reached:r,kind:null,factor:a?.factor??null,decisions:null},m(),t&&y();let{sightings:d}=await g.sightings(s,e);if(n!==o||!a)return;a={...a,sightings:d},m()}catch(t){n===o&&l.failed(e,t)}}function f(){a=null,s=``,l.hide(),r.dock===l.images&&r.clear()}async function p(){a&&await d(a.id)}function m(){if(!a){n.showSelection(null,null,1);return}a={...a,reached:u().reached,decisions:i.decisions()};let e={...a,kind:h(a)},t=iv(e),r=t&&!t.marking?$h(t.cov_m2):null;n.showSelection(t?.xyz_m??null,r,r?a.factor??tg(r):1,t?.marking?.line_m),l.show(e),_(a)}function h(e){let t=i.cones().find(t=>t.id===e.id)?.kind,n=iv(e);return t||!n?t??null:Oh(e.decisions?.decisions??[],e.id,e.history.at(-1)?.xyz_m,!!e.history[0]?.marking).some(e=>e.kind===`suppress`)?`suppressed`:i.state().mode!==`drive`&&!se(n.kind)?`standing`:n.kind}function _(e){let{map:t,id:n,history:a,sightings:o}=e,c=iv(e)??a[0];if(l.images.hidden=!c||!!c.marking,r.dock!==l.images)s=``;else if(c&&o&&!l.images.hidden){let e=`${t} ${n} ${c.version} ${c.changeset_no}`;if(e===s)return;s=e,r.show(pv(t,n,a,c,o),i.state().image,c.kind!==`confirmed`)}}function v(e){let{follow:n,plan:r}=i.state().scene;t.lookFrom(n&&!r?e:null)}function y(){let e=a&&(iv(a)??a.history[0]);e&&t.lookAt(e.xyz_m,9)}return{select:d,clear:f,again:p,draw:m,images:l.images,walked(e){a&&r.dock===l.images&&(i.state().image=e,i.writeChoice())},camera(e){e!==c&&v(e),c=e;let t=a&&(iv(a)??a.history[0]);n.showCamera(e,t?.xyz_m??null)},followImage:()=>v(c),follow:()=>{a&&a.known!==u().known&&d(a.id)}}}function hv(e,t){let n=_(`select`,{id:`map`,onchange:()=>t.chooseMap(n.value)}),r={};function i(e,n,...i){let a=_(`input`,{type:`checkbox`,id:n,onchange:()=>t.change({[e]:a.checked},e===`trajectory`)});return r[e]=a,_(`label`,{class:`check`},a,...i)}let a=_(`div`,{class:`sites-host`}),o=_(`h2`),s=_(`div`,{class:`legend`}),c=_(`div`,{class:`classes`}),l=_(`section`,{hidden:!0},_(`h2`,{textContent:`Classes`}),c),u=_(`button`,{type:`button`,class:`link`,textContent:`clear`,onclick:()=>t.change(Ne(),!1)}),d=_(`input`,{id:`probability`,type:`range`,min:`0`,max:`1`,step:`0.01`,value:`0`}),f=_(`output`,{htmlFor:`probability`});d.addEventListener(`input`,()=>t.change({minProbability:Number(d.value)},!1));let p=i(`points`,`points`,_(`i`,{class:`swatch points`}),`LiDAR points `,_(`kbd`,{textContent:`1`})),m=i(`lines`,`lines`,_(`i`,{class:`swatch lines`}),`Lane boundaries `,_(`kbd`,{textContent:`2`})),h=_(`section`,{class:`base`,hidden:!0},_(`h2`,{textContent:`Base layers`}),p,m);e.append(_(`section`,{},_(`label`,{htmlFor:`map`,textContent:`Map`}),n),a,_(`section`,{},o,s),l,_(`section`,{},_(`label`,{htmlFor:`probability`,title:`Existence probability`},`Sure it stands ≥ `,f),d),h,_(`section`,{},i(`trajectory`,`way`,_(`i`,{class:`swatch path`}),`Drive path`),_(`button`,{type:`button`,class:`wide`,onclick:()=>t.fit()},`Show everything `,_(`kbd`,{textContent:`Home`}))));function g(e,n,r){let i=_(`input`,{type:`checkbox`,id:`kind-${n}`,checked:!e.hidden.has(n),onchange:()=>{let r=new Set(e.hidden);r.delete(n)||r.add(n),t.change({hidden:r},!1)}});return _(`label`,{class:`check`,data:{kind:n}},i,ue(n),Le(n,e),_(`b`,{textContent:r.toLocaleString(`en`)}))}function v({filter:e},n,r){return _(`label`,{class:`check`},_(`input`,{type:`checkbox`,id:`class-${n}`,checked:!e.hiddenClasses?.includes(n),onchange:()=>t.change({filter:Fe(e,n)},!1)}),z(n),_e(n).label,_(`b`,{textContent:r.toLocaleString(`en`)}))}return{sites:a,showMaps(e,t){b(n,...e.map(e=>_(`option`,{value:e.map_name,textContent:`${e.map_name} (${E(e.feature_count,`feature`)})`})),!e.some(e=>e.map_name===t)&&_(`option`,{value:t,textContent:`${t} (no drives yet)`})),n.value=t},showBase(e){for(let[t,n]of[[p,`points`],[m,`lines`]]){let r=e.filter(e=>e.kind===n);t.hidden=!r.length,t.title=r.map(e=>`${e.layer_name}: ${E(e.count,n===`points`?`point`:`line`)}`).join(`
`)}h.hidden=!e.length},show(e,t,n,i,a){let p=R.filter(e=>i.get(e)).map(t=>g(e,t,i.get(t)??0)),m=p.length?n<t.length?`${Ce(t.length-n)} hidden by filters`:``:`No cones on the map at this time.`,h=a>0&&`${Ce(a)} in clusters or outside the view. Filters other than kind and class apply to what is drawn one by one: zoom in.`,y=document.activeElement?.id??``;o.textContent=B()?`Cones shown`:`Objects shown`,l.hidden=Se().size<2&&e.filter.hiddenClasses===null,b(c,...[...Se()].map(([t,n])=>v(e,t,n))),b(s,...p,!!m&&_(`p`,{class:`hint`},m,Me(e)>0&&` – `,Me(e)>0&&u),h&&_(`p`,{class:`hint`,textContent:h})),document.getElementById(y)?.focus(),document.activeElement!==d&&(d.value=String(e.minProbability)),f.textContent=`${(100*e.minProbability).toFixed(0)} %`;for(let t of Object.keys(r))r[t].checked=e[t]}}}var gv=300,_v=100;function vv(e){let t=new Map;for(let n of e){let[e,r]=[Math.floor(n[0]/_v),Math.floor(n[1]/_v)],i=`${e} ${r}`,a=t.get(i);a||t.set(i,a={x:e,y:r,box:[n[0],n[1],n[0],n[1]],points:[],site:-1});let o=a.box;a.box=[Math.min(o[0],n[0]),Math.min(o[1],n[1]),Math.max(o[2],n[0]),Math.max(o[3],n[1])],a.points.push(n)}let n=[],r=Math.ceil(gv/_v)+1;for(let e of t.values()){if(e.site>=0)continue;let i={points:[]};e.site=n.push(i)-1;let a=[e];for(let n=a.pop();n;n=a.pop()){for(let e of n.points)i.points.push(e);for(let i=-4;i<=r;i++)for(let o=-4;o<=r;o++){let r=t.get(`${n.x+i} ${n.y+o}`);!r||r.site>=0||yv(n.box,r.box)>gv||(r.site=e.site,a.push(r))}}}return n.sort((e,t)=>t.points.length-e.points.length)}var yv=(e,t)=>Math.hypot(Math.max(e[0]-t[2],t[0]-e[2],0),Math.max(e[1]-t[3],t[1]-e[3],0));function bv(e,t){let n=new Set,r=e=>Math.floor(e/t);for(let[t,i]of e)for(let e of[-1,0,1])for(let a of[-1,0,1])n.add(`${r(t)+e} ${r(i)+a}`);return([e,t])=>n.has(`${r(e)} ${r(t)}`)}var xv=[`east`,`north-east`,`north`,`north-west`,`west`,`south-west`,`south`,`south-east`];function Sv(e,t){let[n,r]=[t[0]-e[0],t[1]-e[1]],i=Math.hypot(n,r),a=(Math.round(Math.atan2(r,n)*4/Math.PI)+8)%8;return`${i<950?`${Math.round(i/10)*10} m`:`${(i/1e3).toFixed(1)} km`} ${xv[a]??``}`}function Cv({points:e}){return e.reduce((e,t)=>[e[0]+t[0],e[1]+t[1],e[2]+t[2]],[0,0,0]).map(t=>t/e.length)}function wv(e,t){let n=_(`ul`,{class:`sites`}),r=_(`section`,{class:`sites-section`,hidden:!0},_(`h2`,{textContent:`Sites`}),n);e.append(r);let i;return e=>{if(i===e)return;i=e;let a=vv(e?.map(e=>e.xyz)??[]);r.hidden=a.length<2;let[o]=a;b(n,...r.hidden||!o?[]:a.map((e,n)=>_(`li`,{},_(`button`,{type:`button`,onclick:()=>t(e.points)},_(`span`,{textContent:n===0?`Site 1, the largest`:`Site ${n+1}, ${Sv(Cv(o),Cv(e))}`}),_(`b`,{textContent:Ce(e.points.length)})))))}}var[Tv,Ev,Dv]=[6e4,36e5,864e5],Ov=15,kv=84,Av=12,jv=[[`time`,Tv],[`time`,5*Tv],[`time`,15*Tv],[`time`,Ev],[`time`,3*Ev],[`time`,6*Ev],[`time`,12*Ev],[`time`,Dv],[`time`,2*Dv],[`time`,7*Dv],[`month`,1],[`month`,3],[`month`,6],[`year`,1],[`year`,2],[`year`,5],[`year`,10]],Mv=[`Jan`,`Feb`,`Mar`,`Apr`,`May`,`Jun`,`Jul`,`Aug`,`Sep`,`Oct`,`Nov`,`Dec`],Nv={time:1,month:30.4*Dv,year:365.2*Dv},Pv=500;function Fv(e){let t=e.filter(Number.isFinite),[n,r]=t.length?[t.reduce((e,t)=>Math.min(e,t)),t.reduce((e,t)=>Math.max(e,t))]:[Date.now(),Date.now()],i=Math.max((r-n)*.03,10*Tv);return{start:n-i,end:r+i}}function Iv(e,{start:t,end:n},r){let i=[],a=e=>Av+(e-t)/(n-t)*(r-24),o=0;for(let t=0;t<e.length;t++){let n=a(e[t]),s=i.at(-1);if(s&&n-o<Ov)s.last=t,s.x=(o+n)/2;else{if(n<0)continue;if(n>r)break;i.push({first:t,last:t,x:n}),o=n}}return i}function Lv({start:e,end:t},n){let r=Math.max(n/kv,1),[i,a]=jv.find(([n,i])=>(t-e)/(Nv[n]*i)<=r)??[`year`,10**Math.ceil(Math.log10((t-e)/Nv.year/r))],o=new Date(e),s=i===`year`?12*a:a,c=Math.floor((o.getUTCFullYear()*12+o.getUTCMonth())/s)*s,l=t=>i===`time`?(Math.ceil(e/a)+t)*a:Date.UTC(Math.floor(c/12),c%12+t*s),u=Math.min(Math.floor((t-e)/(Nv[i]*a))+3,Pv),d=Array.from({length:u||0},(e,t)=>l(t)).filter(n=>n>=e&&n<=t),[f,p]=[``,-1/0],m=[];for(let r of d){let o=new Date(r).toISOString(),s=i===`time`&&a<Dv?o.slice(0,10):o.slice(0,4),c=i===`year`?o.slice(0,4):i===`month`?Mv[new Date(r).getUTCMonth()]:a>=Dv?o.slice(5,10):o.slice(11,16),l=(r-e)/(t-e)*n,u=s!==f;if(l<p&&!u)continue;let d=m.at(-1);l<p&&d&&Object.assign(d,{text:d.short,major:!1}),f=s;let h=i===`year`?c:a>=Dv&&i===`time`?`${s}-${c}`:`${s} ${c}`,g=u?i===`time`&&a<Dv&&c===`00:00`?s:h:c;p=l+7*g.length+10,m.push({time:r,text:g,short:c,major:u})}return m}function Rv(e){let t=_(`div`,{class:`axis-entries`}),n=_(`div`,{class:`axis-scale`,aria:{hidden:`true`}}),r=(e,t,n)=>_(`button`,{type:`button`,class:`step`,textContent:e,title:t,aria:{label:t},onclick:n}),i=r(`−`,`Zoom out`,()=>y(2)),a=r(`+`,`Zoom in`,()=>y(.5)),o=r(`↔`,`Show the whole timeline`,()=>v(p)),s=_(`div`,{class:`axis-track`},t,n),c=_(`div`,{class:`axis`},s,_(`div`,{class:`axis-zoom`},a,i,o)),l=[],u=[],d=[],f=-1,p=Fv([]),m=p,h=0,g=[];function v({start:t,end:n}){let r=Math.min(Math.max(n-t,10*Tv),p.end-p.start),i=Math.min(Math.max((t+n-r)/2,p.start),p.end-r);m={start:i,end:i+r},C(),e.zoomed?.()}function y(e,t=l[f]??(m.start+m.end)/2){let n=t>=m.start&&t<=m.end?t:(m.start+m.end)/2;v({start:n-(n-m.start)*e,end:n+(m.end-n)*e})}let x=e=>m.start+(e-Av)/Math.max(s.clientWidth-24,1)*(m.end-m.start);s.addEventListener(`wheel`,e=>{e.preventDefault();let t=e.clientX-s.getBoundingClientRect().left,n=(m.end-m.start)*e.deltaX/Math.max(s.clientWidth,1);Math.abs(e.deltaX)>Math.abs(e.deltaY)?v({start:m.start+n,end:m.end+n}):y(Math.exp(Math.min(Math.max(e.deltaY,-200),200)*.003),x(t))},{passive:!1});let S=null;s.addEventListener(`pointerdown`,e=>{S={x:e.clientX,span:m,moved:!1}}),s.addEventListener(`pointermove`,e=>{if(!S||!e.buttons)return;let t=e.clientX-S.x;if(!S.moved&&Math.abs(t)<5)return;S.moved||s.setPointerCapture(e.pointerId),S.moved=!0;let{start:n,end:r}=S.span,i=-t/Math.max(s.clientWidth,1)*(r-n);v({start:n+i,end:r+i})}),s.addEventListener(`click`,e=>{S?.moved&&e.stopPropagation(),S=null},!0);function C(){let r=s.clientWidth;if(h=r,g=[],!r||!l.length)return b(t);let c=Iv(l,m,r),y=c.reduce((t,n)=>Math.max(t,e.weight(u.slice(n.first,n.last+1))),1);b(t,...c.map(({first:t,last:n,x:r})=>{let i=n-t+1,{bars:a,title:o}=e.entry(u.slice(t,n+1),y),s=_(`button`,{type:`button`,class:i>1?`column cluster`:`column`,tabIndex:-1,title:i>1?`${E(i,`drive`)}, ${o}. Click to zoom in.`:o,onclick:()=>{let r=f>=t&&f<=n,[a,o]=[l[t],l[n]],s=Math.max((o-a)*1.3,10*Tv);i>1&&s<(m.end-m.start)*.9?v({start:(a+o-s)/2,end:(a+o+s)/2}):e.choose(u[r&&f<n?f+1:r&&i>1?t:n]??-1)}},_(`span`,{class:`bars`},...a),i>1&&_(`span`,{class:`count`,textContent:String(i)}));return s.style.left=`${r.toFixed(1)}px`,g.push([s,t,n]),i===1&&(s.dataset.changeset=String(d[u[t]??-1]?.changeset_no)),s})),b(n,...Lv(m,r).map(({time:e,text:t,major:n})=>{let i=_(`span`,{class:n?`major`:``,textContent:t});return i.style.left=`${(Av+(e-m.start)/(m.end-m.start)*(r-24)).toFixed(1)}px`,i}));let x=m.end-m.start>=(p.end-p.start)*.999;i.disabled=o.disabled=x,a.disabled=m.end-m.start<=10*Tv,w()}function w(){for(let[e,t,n]of g)e.classList.toggle(`chosen`,f>=t&&f<=n)}return new ResizeObserver(()=>{s.clientWidth!==h&&C()}).observe(s),{node:c,span:()=>m,whole:()=>p,show(e,t){let n=e!==d;if(n){d=e;let t=e.map(e=>Date.parse(e.captured_from));u=t.map((e,t)=>t).sort((e,n)=>t[e]-t[n]),l=u.map(e=>t[e]);let n=m.end-m.start>=(p.end-p.start)*.999;p=Fv([...l,...e.map(e=>Date.parse(e.valid_at))]),n&&(m=p)}else if(u[f]===t)return;f=u.indexOf(t);let r=l[f],i=(m.end-m.start)/2;r!==void 0&&(r<m.start||r>m.end)?v({start:r-i,end:r+i}):n?v(m):w()}}}var zv=[[`instant`,`The road`],[`drive`,`Drive by drive`],[`compare`,`Compare two`]],Bv=[[`before`,`Before`],[`changes`,`Changes`],[`after`,`After`]],Vv=[`added`,`moved`,`removed`,`split`,`merged`,`height_changed`,`missed`,`confirmed`],Hv=30,Uv=(e,t)=>e.change_counts.points[t]??0,Wv=(e,t)=>e.change_counts.lines[t]??0,Gv=(e,t)=>Uv(e,t)+Wv(e,t);function Kv(e,t,n){return Vv.flatMap(r=>{let i=e.reduce((e,n)=>e+t(n,r),0);return i?[{kind:r,count:i,text:`${n(i)} ${L[r].label}`}]:[]})}var qv=e=>E(e,`stretch of lane markings`,`stretches of lane markings`),Jv=e=>[...Kv(e,Uv,e=>e.toLocaleString(`en`)),...Kv(e,Wv,qv)];function Yv(e,t){let[n,r]=[null,[]],i=Xv(`View mode`,zv,i=>{e.classList.toggle(`open`,i!==n?.mode||!e.classList.contains(`open`));let a=i===`compare`&&n?.from===0&&n.to===null;t.change({mode:i,...a&&{from:Zv(r)}})}),a=_(`div`,{class:`timeline-body`});e.append(i.node,a);let o={drive:ey(t),compare:ry(t),instant:iy(t)};return(e,t)=>{[n,r]=[e,t],i.set(e.mode);let s=o[e.mode];a.firstElementChild!==s.node&&b(a,s.node),s.update(e,t)}}function Xv(e,t,n){let r=t.map(([e,t])=>_(`button`,{type:`button`,textContent:t,data:{value:e},onclick:()=>n(e)}));return{node:_(`div`,{class:`segmented`,role:`group`,aria:{label:e}},...r),set:e=>{for(let t of r)t.setAttribute(`aria-pressed`,String(t.dataset.value===e))}}}function Zv(e){let t=e.map(e=>S(e.captured_from).slice(0,10));return e.filter((e,n)=>t[n]!==t.at(-1)).at(-1)?.changeset_no??0}function Qv(t,n){let r=Kv(t,Gv,String).map(({kind:e,count:t})=>{let r=_(`i`,{});return r.style.height=`${Math.max(2,t/n*Hv).toFixed(1)}px`,r.style.background=sp(e),r}),i=t.filter(e=>e.hold!==null);i.length&&r.push(_(`i`,{class:`held`}));let a=Jv(t).map(e=>e.text).join(`, `),[o]=t;return t.length===1&&o?{bars:r,title:`${e(o)}, ${S(o.captured_from)} UTC: ${o.hold===null?a:`on hold. ${o.hold}`}`}:{bars:r,title:`${a||`no changes`}${i.length?`, ${i.length} on hold`:``}`}}function $v(e,t,n){let r=t=>t.flatMap(t=>e()[t]??[]),i=e=>Vv.reduce((t,n)=>t+Gv(e,n),0);return Rv({choose:t,zoomed:n,weight:e=>r(e).reduce((e,t)=>e+i(t),0),entry:(e,t)=>Qv(r(e),t)})}function ey(e){let t=_(`input`,{type:`range`,class:`changeset-slider`,min:`0`,step:`1`,aria:{label:`Drive`}}),n=(e,t,n,r)=>_(`button`,{type:`button`,class:`step`,title:`${n} (${r})`,textContent:t,aria:{label:n},onclick:()=>d(u+e)}),r=n(-1,`‹`,`Previous drive`,`,`),i=n(1,`›`,`Next drive`,`.`),a=Xv(`Before or after this drive`,Bv,t=>e.change({side:t})),o=_(`div`,{class:`drive-text`,aria:{live:`polite`}}),s=_(`div`,{class:`drive-decide`}),c=Fh(s),l=[],u=0,d=t=>{let n=l[t];n&&e.change({changeset:t===l.length-1?null:n.changeset_no})};t.addEventListener(`input`,()=>d(Number(t.value)));let f=$v(()=>l,d);return{node:_(`div`,{class:`drive-view`},_(`div`,{class:`drive-line`},o,s,a.node),_(`div`,{class:`drive-track`},r,t,f.node,i)),update(n,d){l=d;let p=l.findIndex(e=>e.changeset_no===n.changeset),m=p<0&&n.changeset!==null;u=p<0?l.length-1:p,t.max=String(Math.max(l.length-1,0)),t.value=String(u),t.disabled=l.length<2,r.disabled=u<=0,i.disabled=u>=l.length-1,a.set(n.side),f.show(l,m?-1:u);let h=l[u];if(s.hidden=m,m)return b(o,_(`strong`,{textContent:`No changeset ${n.changeset}`}));if(!h)return b(o);let g=e.writableMap(),v=e.decisions().filter(e=>e.changeset_id===h.changeset_id),y=!v.some(e=>e.kind===`revert`)&&(h.counts||h.hold!==null),x=g===null?[]:[...v.map(jh),...y?[Mh(h)]:[]];c.show(`${h.changeset_id} ${v.map(e=>e.decision_id).join(` `)} ${String(h.counts)} ${String(g)}`,x,{map:g??``,changed:()=>e.decided()});let S=l.filter(e=>e.kind===`drive`),C=h.kind===`drive`?`drive ${S.indexOf(h)+1} of ${S.length}`:`imported map`;t.setAttribute(`aria-valuetext`,`${h.drive_id}, ${C}`),b(o,_(`strong`,{textContent:h.drive_id}),_(`span`,{textContent:[C,...h.kind===`drive`?[`recorded ${T(h.captured_from)}`,E(h.frame_pair_count,`frame pair`)]:[`state of the road on ${T(h.captured_from)}`],`saved ${T(h.committed_at)}, as known then`].join(` · `)}),_(`span`,{class:`chips`},...Jv([h]).map(t=>Ng(t.kind,t.text,t=>e.showChanges(n.changeset,t))),!h.counts&&ty(v,h.hold),h.hold!==null&&_(`span`,{class:`hold-reason`,title:h.hold,textContent:h.hold})))}}}function ty(e,t){if(t!==null)return _(`span`,{class:`chip off`,title:t,textContent:`on hold`});let n=e.some(e=>e.kind===`revert`);return _(`span`,{class:`chip off`,title:n?`Reverted by a decision: not part of the map.`:`Not part of the map: reverted, or replaced by a later analysis or delivery of the same recording.`,textContent:n?`reverted`:`not counted`})}function ny(t){let n=null,r=_(`select`,{onchange:()=>t.change({known:r.value===`now`?null:Number(r.value)})});return{node:_(`label`,{},`As known `,r),update:(t,i)=>{n!==i&&(n=i,b(r,_(`option`,{value:`now`,textContent:`now`}),...i.map(t=>_(`option`,{value:String(t.changeset_no),textContent:`at ${S(t.committed_at)} UTC · after ${e(t)}`})))),r.value=t.known===null?`now`:String(t.known)}}}function ry(t){let[n,r]=[_(`select`,{}),_(`select`,{})],i=ny(t),a=e=>e.value===`latest`?null:Number(e.value),[o,s]=[_(`input`,{type:`checkbox`,id:`swipe`}),_(`input`,{type:`checkbox`,id:`split`})],c=null;for(let[e,n]of[[o,.5],[s,`split`]])e.addEventListener(`change`,()=>c&&t.change({scene:{...c.scene,swipe:e.checked?n:null}},!1));let l=0,u=null,d=()=>t.change({from:a(n)??l,to:a(r)});n.addEventListener(`change`,d),r.addEventListener(`change`,d);let f=_(`button`,{type:`button`,class:`step`,textContent:`⇄`,title:`Swap`,aria:{label:`Swap`}});return f.addEventListener(`click`,()=>t.change({from:a(r)??l,to:a(n)??l})),{node:_(`div`,{class:`form-line`},_(`label`,{},`From `,n),f,_(`label`,{},`to `,r),i.node,_(`label`,{class:`check`,title:`Show the first state left of a divider, the second right of it`},o,`Swipe`),_(`label`,{class:`check`,title:`Show both states, each in a half of the picture`},s,`Side by side`),_(`p`,{class:`hint`,textContent:`A cone counts as moved if it shifted by more than min_gate_m, a parameter of the newest drive (0.5 m by default).`})),update(e,t){c=e,l=t.at(-1)?.changeset_no??0,u!==t&&p(t),n.value=e.from===l?`latest`:String(e.from),r.value=e.to===null||e.to===l?`latest`:String(e.to),f.disabled=e.from===0,o.checked=typeof e.scene.swipe==`number`,s.checked=e.scene.swipe===`split`,i.update(e,t)}};function p(t){u=t;let i=()=>t.map((n,r)=>_(`option`,{value:r===t.length-1?`latest`:String(n.changeset_no),textContent:`${S(n.captured_from,!1)} · after ${e(n)}`}));b(n,_(`option`,{value:`0`,textContent:`empty map, before the first drive`}),...i()),b(r,...i())}}function iy(e){let t=_(`input`,{type:`range`,class:`instant-slider`,min:`0`,max:`1000`,step:`1`,aria:{label:`Time on the road`}}),n=_(`input`,{type:`text`,size:19,placeholder:`2026-03-02 09:41:07`,spellcheck:!1,autocomplete:`off`}),r=_(`button`,{type:`button`,textContent:`Now`,title:`The road now`,onclick:()=>e.change({valid:null})}),i=ny(e),a=_(`div`,{class:`drive-text`}),o=[],s=null,c=t=>e.change({valid:new Date(t).toISOString()}),l=$v(()=>o,e=>o[e]&&c(Date.parse(o[e].valid_at)+1),()=>d());t.addEventListener(`input`,()=>{let n=Number(t.value),{start:r,end:i}=l.span();n>=1e3&&i>=l.whole().end?e.change({valid:null}):c(r+(i-r)*n/1e3)}),n.addEventListener(`change`,()=>{let e=n.value.trim().replace(` `,`T`),t=Date.parse(e.includes(`T`)?`${e}Z`:e);n.setCustomValidity(Number.isNaN(t)?`Enter a UTC time such as 2026-03-02 or 2026-03-02 09:41:07`:``),n.reportValidity()&&c(t)});let u=()=>s===null?l.whole().end:Date.parse(s);function d(){let{start:e,end:n}=l.span();document.activeElement!==t&&(t.value=String(Math.round((u()-e)/(n-e)*1e3)))}return{node:_(`div`,{class:`instant-view`},_(`div`,{class:`form-line`},_(`label`,{},`Time on the road (UTC) `,n),r,i.node,a),_(`div`,{class:`instant-track`},l.node,t)),update(t,c){if(!c.length)return;o=c,s=t.valid,l.show(o,o.findIndex(e=>Date.parse(e.valid_at)+1===u())),d(),n.validity.valid&&(n.value=S(new Date(u()).toISOString())),r.disabled=t.valid===null;let f=o.filter(e=>Date.parse(e.valid_at)<=u()).at(-1),p=f===o.at(-1)?null:f?.changeset_no??null;b(a,f&&_(`span`,{},`Last drive `,_(`button`,{type:`button`,class:`link`,title:`Show its changes`,textContent:f.drive_id,onclick:()=>e.change({mode:`drive`,changeset:p,side:`changes`})})),f&&_(`span`,{class:`chips`},...Jv([f]).map(t=>Ng(t.kind,t.text,t=>e.showChanges(p,t))),!f.counts&&ty([],f.hold))),i.update(t,o)}}}var ay=70;function oy(e,t,n){let r=_(`span`,{class:`mono`}),i=_(`span`,{class:`mono`}),a=_(`button`,{type:`button`,class:`cursor`,hidden:!0,disabled:!0,title:`Copy these coordinates (X)`},r,i),o=_(`i`,{class:`pin`,hidden:!0,aria:{hidden:`true`}}),s=_(`div`,{class:`where`,title:`Middle of the picture: nearest town (GeoNames, CC BY 4.0), latitude, longitude`}),c=_(`div`,{class:`grid-labels`,hidden:!0,aria:{hidden:`true`}});t.append(c,o,a),t.querySelector(`.scalebar`)?.append(s);let l=[0,0,0],u=0,d=null,f=null,p=!1;function m(){let e=f??d;if(a.hidden=e===null,a.disabled=f===null,!e)return;r.textContent=`${(e[0]+l[0]).toFixed(2)} E  ${(e[1]+l[1]).toFixed(2)} N`;let t=n.at([e[0],e[1]]),o=t&&Tp(t,[e[0],e[1]]);i.textContent=o?`${o[0].toFixed(7)}, ${o[1].toFixed(7)}`:``}function h(t,n){d=e.groundAt(t,n),m()}async function g(){a.hidden||(await ie(`EPSG:${u} ${r.textContent}\tlon, lat ${i.textContent}`),a.classList.add(`copied`),window.setTimeout(()=>a.classList.remove(`copied`),1200))}let v=!1;e.canvas.addEventListener(`pointermove`,e=>{if(v)return;v=!0;let[t,n]=[e.offsetX,e.offsetY];requestAnimationFrame(()=>{v&&h(t,n),v=!1})}),e.canvas.addEventListener(`pointerleave`,()=>{v=!1,d=null,m()}),a.addEventListener(`click`,()=>void g()),e.beforeDraw(()=>{let[t,r]=e.pose(),i=u?n.at([t,r]):null,a=i&&Tp(i,[t,r]),l=i&&Op(i,[t,r]);s.textContent=a?`${l?`${l}\n`:``}${a[1].toFixed(5)}, ${a[0].toFixed(5)}`:``;let d=f&&e.project(f);o.hidden=!d,d&&(o.style.transform=`translate(${d[0].toFixed(1)}px, ${d[1].toFixed(1)}px)`),c.hidden=!p||!e.plan,c.hidden||y()});function y(){let{clientWidth:t,clientHeight:n}=e.canvas,[r,i,a]=[[0,0],[0,n],[t,n]].map(([t,n])=>e.groundAt(t??0,n??0));if(!r||!i||!a)return;let o=[];for(let[s,c,u,d]of[[0,a,t,`E`],[1,r,n,`N`]]){let[t,r]=[i[s]+l[s],c[s]+l[s]],a=Math.abs(r-t);if(a<1e-6)continue;let f=e.gridStep;for(;f/a*u<ay;)f*=f.toString().replace(/[.0]/g,``).startsWith(`2`)?2.5:2;for(let e=Math.ceil(Math.min(t,r)/f)*f;e<=Math.max(t,r);e+=f){let i=(e-t)/(r-t)*u,a=_(`span`,{class:s?`north-label`:`east-label`,textContent:`${e.toFixed(+(f<1))} ${d}`});a.style.transform=s?`translate(0, ${Math.round(n-i)}px)`:`translate(${Math.round(i)}px, 0)`,o.push(a)}}c.replaceChildren(...o)}return{open(e,t){l=e,u=t,m()},refresh:()=>m(),copy:()=>void g(),pin(t){f=t&&[...t,e.ground],m(),e.draw()},labels(t){p=t,e.draw()}}}function sy(e,t){let n=(e,t,n)=>{let r=_(`select`,{id:e,onchange:()=>n(r.value)});return r.append(...t.map(([e,t])=>_(`option`,{value:e,textContent:t}))),r},r=(e,t,n,r,i)=>{let a=_(`input`,{id:e,type:`range`,min:String(t),max:String(n),step:String(r)});return a.addEventListener(`input`,()=>i(Number(a.value))),a},i=n(`point-colour`,[[`intensity`,`intensity`],[`height`,`height above ground`],[`one`,`one colour`]],e=>t.change({colouring:e})),a=r(`point-size`,.5,4,.5,e=>t.change({size:e})),o=r(`point-opacity`,.1,1,.05,e=>t.change({opacity:e})),s=r(`basemap-opacity`,0,1,.05,e=>t.change({basemap:e})),c=n(`grid`,[[`lines`,`lines`],[`labels`,`lines with coordinates (plan only)`],[`none`,`none`]],e=>t.change({grid:e})),l=_(`input`,{id:`shading`,type:`checkbox`,onchange:()=>t.change({shading:l.checked})}),u=(e,t)=>_(`label`,{htmlFor:t.id},_(`span`,{textContent:e}),t),d=_(`div`,{class:`group`},u(`Point colour`,i),u(`Point size`,a),u(`Point opacity`,o),u(`Light by depth`,l)),f=u(`Base map opacity`,s),p=_(`button`,{type:`button`,class:`link`,textContent:`Reset`,onclick:()=>{let{colouring:e,shading:n,size:r,opacity:i,basemap:a,grid:o}=Re;t.change({colouring:e,shading:n,size:r,opacity:i,basemap:a,grid:o})}}),m=_(`button`,{type:`button`,id:`paper`,textContent:`Paper`,title:`As in Figure 6 of the paper: LiDAR red, lane boundaries green, the new cone blue; before | after side by side`,onclick:()=>t.paper(m.getAttribute(`aria-pressed`)!==`true`)}),h=_(`div`,{class:`layers-panel`,id:`layers-panel`,hidden:!0},u(`Show as in`,m),d,f,u(`Grid`,c),p),g=_(`button`,{type:`button`,textContent:`Layers`,aria:{expanded:`false`,controls:`layers-panel`}});v(g,h);let y=_(`button`,{type:`button`,id:`plan`,title:`Switch between plan and 3D (T)`,onclick:()=>t.change({plan:y.textContent===`Plan`})}),b=_(`button`,{type:`button`,id:`measure`,textContent:`Measure`,title:`Measure distances and areas (M)`,onclick:()=>t.measure()});return e.append(_(`div`,{class:`map-tools`,role:`toolbar`,aria:{label:`Map`}},y,b,g,h)),{offer(e){e.points!==void 0&&(d.hidden=!e.points),e.basemap!==void 0&&(f.hidden=!e.basemap)},show(e){y.textContent=e.plan?`3D`:`Plan`,b.setAttribute(`aria-pressed`,String(e.measure!==null)),m.setAttribute(`aria-pressed`,String(e.paper)),l.checked=e.shading,i.value=e.colouring,c.value=e.grid;for(let[t,n]of[[a,e.size],[o,e.opacity],[s,e.basemap]])document.activeElement!==t&&(t.value=String(n))}}}var[cy,ly,uy]=[168,116,8],dy=3;function fy(e,t){let n=_(`canvas`,{class:`minimap-canvas`,width:2*cy,height:2*ly}),r=_(`div`,{class:`minimap`,hidden:!0,title:`Overview: click to move the view`,aria:{hidden:`true`}},n);t.append(r);let i=_(`canvas`,{width:n.width,height:n.height}),a=[],[o,s,c,l]=[0,0,0,0],u=1,d=!0,f=e=>uy+(e-o)*u+(cy-2*uy-(c-o)*u)/2,p=e=>ly-uy-(e-s)*u-(ly-2*uy-(l-s)*u)/2;function m(){let e=i.getContext(`2d`);if(d=!1,e){e.setTransform(2,0,0,2,0,0),e.clearRect(0,0,cy,ly);for(let t of a)e.fillStyle=op(t.kind),e.fillRect(f(t.xyz[0])-1,p(t.xyz[1])-1,2,2)}}e.beforeDraw(()=>{let t=e.canvas.clientWidth/e.pixelsAtDepth(e.pose()[5]),a=Math.max(c-o,l-s)>dy*Math.min(t,t*e.canvas.clientHeight/e.canvas.clientWidth)?Bp(e):[],[h,g]=[my(a.map(e=>e[0])),my(a.map(e=>e[1]))];r.hidden=a.length<3||c-o<dy*h&&l-s<dy*g;let _=r.hidden?null:n.getContext(`2d`);if(!_)return;d&&m(),_.setTransform(1,0,0,1,0,0),_.clearRect(0,0,n.width,n.height),_.drawImage(i,0,0),_.setTransform(2,0,0,2,0,0),_.strokeStyle=ip().ellipse,_.lineWidth=1.5;let[v,y]=[f(hy(a,0)),p(hy(a,1))];_.beginPath(),h*u<6?_.arc(v,y,5,0,2*Math.PI):a.forEach((e,t)=>t?_.lineTo(f(e[0]),p(e[1])):_.moveTo(f(e[0]),p(e[1]))),_.closePath(),_.stroke()});let h=t=>{let[,,n,r,i,a]=e.pose(),[c,l]=[t.offsetX,t.offsetY];e.setPose([o+(c-f(o))/u,s-(l-p(s))/u,n,r,i,a])};return r.addEventListener(`pointerdown`,e=>{r.setPointerCapture(e.pointerId),h(e)}),r.addEventListener(`pointermove`,e=>e.buttons&&h(e)),{show(e){a=e;let[t,n]=[a.map(e=>e.xyz[0]),a.map(e=>e.xyz[1])];[o,c,s,l]=[...py(t),...py(n)],u=Math.min((cy-2*uy)/Math.max(c-o,1),(ly-2*uy)/Math.max(l-s,1)),d=!0}}}var py=e=>e.reduce(([e,t],n)=>[Math.min(e,n),Math.max(t,n)],[1/0,-1/0]),my=e=>py(e)[1]-py(e)[0],hy=(e,t)=>e.reduce((e,n)=>e+n[t],0)/e.length,gy=.02;function _y(e,t,n,r,i){let[a,o]=[_(`span`,{class:`side left`}),_(`span`,{class:`side right`})],s=_(`div`,{class:`swipe`,tabIndex:0,role:`slider`,hidden:!0,aria:{label:`Divider between the two states`,valuemin:`0`,valuemax:`100`,orientation:`horizontal`}},a,o,_(`i`));t.append(s);let c=null,l=null,u=null,d=e=>i(Math.round(Math.min(Math.max(e,0),1)*1e3)/1e3);s.addEventListener(`pointerdown`,e=>{s.setPointerCapture(e.pointerId),s.focus(),e.preventDefault()}),s.addEventListener(`pointermove`,e=>{s.hasPointerCapture(e.pointerId)&&d((e.clientX-t.getBoundingClientRect().left)/t.clientWidth)}),s.addEventListener(`keydown`,e=>{let t={ArrowLeft:-.02,ArrowRight:gy,PageDown:-5*gy,PageUp:5*gy,Home:-1,End:1}[e.key];t!==void 0&&(e.preventDefault(),e.stopPropagation(),d((u??.5)+t))});function f(){let{renderer:t,scene:n,camera:r,canvas:i}=e,[a,o]=[i.clientWidth,i.clientHeight],s=Math.round(a*(u??.5)),d=e.halfShift();t.setScissorTest(!0);for(let e of[0,1])c?.forEach((t,n)=>t.setVisible(e===n&&l!==null)),t.setScissor(e?s:0,0,e?a-s:s,o),t.setViewport(e?d:-d,0,a,o),t.render(n,r);t.setScissorTest(!1),t.setViewport(0,0,a,o)}return{show(t,i,d){let p=t===`split`;u=t===`split`?.5:t,e.setSplit(p);let m=u!==null&&i!==null;if(s.hidden=!m,s.classList.toggle(`fixed`,p),s.tabIndex=p?-1:0,s.setAttribute(`role`,p?`separator`:`slider`),n.setVisible(!m),e.canvas.dataset.swipe=m?String(t):``,!m&&p?e.setRender(f):m||(c?.forEach(e=>e.setVisible(!1)),e.setRender(null)),!i)return void(l=null);c??=[r(),r()],l!==i&&(l=i,c.forEach((e,t)=>e.show(i?.[t]??[]))),s.style.left=`clamp(11px, ${(u??0)*100}%, 100% - 11px)`,s.setAttribute(`aria-valuenow`,String(Math.round((u??0)*100))),s.setAttribute(`aria-valuetext`,`${Math.round((u??0)*100)} %: left ${d[0]}, right ${d[1]}`),[a.textContent,o.textContent]=d,e.setRender(f)},pick(t,r){return u===null||!c||!l?n.pick(t,r):c[t<e.canvas.clientWidth*u?0:1].pick(e.unsplit(t),r)},redraw:()=>c?.forEach((e,t)=>e.show(l?.[t]??[]))}}function vy(e,t,n,r){let i=()=>r.state().scene,{change:a}=r,o=Ap(()=>{s.refresh(),e.draw()}),s=oy(e,t,o),c=zp(e,t,o,r.trouble),l=fy(e,t),u=re(e,t,{map:()=>r.state().map,cone:e=>r.cones().find(t=>t.id===e),changed:e=>a({measure:e})}),d=_y(e,t,n,()=>Jm(e),e=>a({swipe:e})),f=sy(t,{change:a,measure:()=>u.toggle(),paper:r.paper}),p=null,m=null,h=[mm(e),mm(e)],g=``,_=e.ground;cp(()=>{r.redraw(),d.redraw()});async function v(e){if(!p)return;let t=tm(e,p.changesets),n=JSON.stringify([e.map,t,p.changesets.at(-1)?.changeset_no]);if(n!==g){g=n,m=null;try{await Promise.all(h.map((n,r)=>n.open(e.map,t[r]))),g===n&&await y()}catch(e){g=``,r.trouble(`The two states cannot be compared: ${j(e)}`)}}}async function y(){let e=g,t=await Promise.all(h.map(e=>e.load()));if(e!==g||m&&!t.some(Boolean))return;let n=new Map(r.cones().map(e=>[e.id,e.kind])),i=({shown:e},t)=>e().cones.map(e=>({...e,kind:t.find(t=>t===n.get(e.id))??e.kind}));m=[i(h[0],[`moved`]),i(h[1],[`moved`,`added`,`split`,`height_changed`])],b(r.state())}function b(t){let{scene:n}=t;e.setPlan(n.plan),e.showGrid(n.grid!==`none`),s.labels(n.grid===`labels`),s.pin(n.at),c.apply(n.basemap),_!==e.ground&&(_=e.ground,c.clear()),f.show(n);let r=t.mode===`compare`&&n.swipe!==null;r?v(t):[m,g]=[null,``],d.show(r?n.swipe:null,r?w(t):null,r?x(t):[``,``])}function x(e){let t=e=>{let t=Up(p?.changesets??[],e);return t?`after ${S(t.captured_from,!1)}`:``};return[e.from===0?`before the first drive`:t(e.from),t(e.to)]}let C=null;function w(e){if(!m)return null;let t=JSON.stringify([[...e.hidden],e.minProbability,e.filter]);if(C?.of!==m||C.by!==t){let n=Ae(e);C={of:m,by:t,cones:[m[0].filter(n),m[1].filter(n)]}}return C.cones}function T(e,t){let n=d.pick(e,t);return n?.marking?null:n}return{open(e){p=e,e&&(o.open(e.map_name),s.open(e.origin_m,e.srid)),g=``},basemap(e){c.open(e),f.offer({basemap:e!==null})},points:e=>f.offer({points:e}),setPose(t){e.setPlan(i().plan,!0),e.setPose(t)},apply:b,show(e){l.show(e)},moved:()=>void(m&&y().catch(e=>r.trouble(j(e)))),openMeasure:()=>u.open(i().measure),pick:(e,t)=>d.pick(e,t),click:(t,n)=>u.active()&&u.click(T(t,n),e.groundAt(t,n)),clickGround(t,n){let r=i().at===null?e.groundAt(t,n):null;a({at:r&&[Math.round(r[0]*1e3)/1e3,Math.round(r[1]*1e3)/1e3]})},escape(){if(u.active())u.end();else if(i().at!==null)a({at:null});else return!1;return!0},key(e){if(u.key(e))return!0;if(e.key===`t`||e.key===`T`)a({plan:!i().plan});else if(e.key===`x`||e.key===`X`)s.copy();else return!1;return!0}}}var yy=120;function by(){let e=new Map,t=new Map;function n(e,t,n,r){let i=e.get(t);if(i)return i;let a=n();e.set(t,a),a.catch(()=>e.delete(t));let o=e.size>yy?e.keys().next().value:void 0;return o!==void 0&&(e.get(o)?.then(r,()=>void 0),e.delete(o)),a}async function r(e,t,n,r){if(t[n].problem!==null)return{url:null,problem:t[n].problem};try{let i=URL.createObjectURL(await g.image(e,t.drive_uuid,t.frame_index,n,r));return await Object.assign(new Image,{src:i}).decode().catch(()=>void 0),{url:i,problem:null}}catch(e){return{url:null,problem:j(e)}}}return{frame:(t,r,i)=>n(e,`${t} ${r} ${i}`,()=>g.frame(t,r,i),()=>void 0),image:(e,i,a,o)=>n(t,`${e} ${i.drive_uuid} ${i.frame_index} ${a} ${o??``}`,()=>r(e,i,a,o),({url:e})=>e&&URL.revokeObjectURL(e))}}var xy=`http://www.w3.org/2000/svg`,Sy=64,Cy=.0016;function wy(e){let t=_(`img`,{draggable:!1}),n=document.createElementNS(xy,`svg`);n.setAttribute(`aria-hidden`,`true`);let r=_(`p`,{class:`pane-problem`,hidden:!0}),i=_(`figcaption`,{}),a=_(`figure`,{class:`pane`},t,n,r,i),o=null,s={scale:null,offset:[0,0]},c=()=>(o?Math.min(a.clientWidth/o.size[0],a.clientHeight/o.size[1]):1)||1,l=()=>s.scale??c();function u(){return o?s.scale===null?[o.size[0]/2,o.size[1]/2]:[d(0,a.clientWidth),d(1,a.clientHeight)]:[0,0]}function d(e,t){if(!o)return 0;let[n,r]=[o.size[e],t/l()/2];return n<2*r?n/2:Math.min(Math.max(o.anchor[e]+s.offset[e],r),n-r)}function f([e,t]){let[n,[r,i]]=[l(),u()];return[(e-r)*n+a.clientWidth/2,(t-i)*n+a.clientHeight/2]}function p(e,t){let[n,[r,i]]=[l(),u()];return[(e-a.clientWidth/2)/n+r,(t-a.clientHeight/2)/n+i]}function m(){if(!o||!a.clientWidth)return;let[e,r]=f([0,0]),i=l();t.style.transform=`translate(${e}px, ${r}px) scale(${i})`,t.classList.toggle(`pixels`,i>=3),n.replaceChildren(...o.shapes.flatMap(h))}function h({points:e,style:t,closed:n=!0,text:r}){let i=e.map(f),o=i.map(([e,t],n)=>`${n?`L`:`M`}${e.toFixed(1)} ${t.toFixed(1)}`).join(``)+(n?`Z`:``),s=[`rim`,t].map(e=>{let t=document.createElementNS(xy,`path`);return t.setAttribute(`d`,o),t.setAttribute(`class`,e),t});if(!r)return s;let c=document.createElementNS(xy,`text`),[l,u]=[Math.min(...i.map(e=>e[0])),Math.min(...i.map(e=>e[1]))];return c.setAttribute(`x`,l.toFixed(1)),c.setAttribute(`y`,(u>16?u-5:u+14).toFixed(1)),c.setAttribute(`class`,t),l>.8*a.clientWidth&&c.setAttribute(`text-anchor`,`end`),c.textContent=r,[...s,c]}function g(t,n,r){if(!o||!e)return;let[i,[s,u]]=[l(),p(n,r)],d=Math.min(Math.max(i*t,c()),Sy);if(d<=c()*1.001&&t<1)return e.view({scale:null,offset:[0,0]});let[f,m]=[s-(n-a.clientWidth/2)/d,u-(r-a.clientHeight/2)/d];e.view({scale:d,offset:[f-o.anchor[0],m-o.anchor[1]]})}function v(t,n){if(!o||!e)return;let[r,[i,a]]=[l(),u()];e.view({scale:r,offset:[i-t/r-o.anchor[0],a-n/r-o.anchor[1]]})}return e&&Ty(a,{zoomAt:g,pan:v,pick:(t,n)=>e.pick(p(t,n))}),new ResizeObserver(m).observe(a),{node:a,show(e,n){o=e,s=n,e.url!==null&&t.getAttribute(`src`)!==e.url&&(t.src=e.url),t.hidden=e.url===null,t.alt=e.alt,t.width=e.size[0],t.height=e.size[1],r.hidden=e.problem===null,r.textContent=e.problem??``,b(i,e.caption),m()},setView(e){s=e,m()},zoom:e=>g(e,a.clientWidth/2,a.clientHeight/2),fit:c,pan:v}}function Ty(e,{zoomAt:t,pan:n,pick:r}){let i=new Map,a=0,o=t=>{let n=e.getBoundingClientRect();return[t.clientX-n.left,t.clientY-n.top]};e.addEventListener(`wheel`,e=>{e.preventDefault(),t(Math.exp(-e.deltaY*Cy*(e.deltaMode===1?30:1)),...o(e))},{passive:!1}),e.addEventListener(`pointerdown`,t=>{t.button===0&&(e.setPointerCapture(t.pointerId),i.size||(a=0),i.set(t.pointerId,o(t)))}),e.addEventListener(`pointermove`,e=>{let r=i.get(e.pointerId);if(!r)return;let s=o(e),[c,l]=[s[0]-r[0],s[1]-r[1]];a+=Math.hypot(c,l);let u=[...i].find(([t])=>t!==e.pointerId)?.[1];if(i.set(e.pointerId,s),u){let e=e=>Math.hypot(e[0]-u[0],e[1]-u[1])||1;n(c/2,l/2),t(e(s)/e(r),(s[0]+u[0])/2,(s[1]+u[1])/2)}else a>3&&n(c,l)});for(let t of[`pointerup`,`pointercancel`])e.addEventListener(t,e=>{i.delete(e.pointerId)&&t===`pointerup`&&!i.size&&a<=3&&r(...o(e))});e.addEventListener(`dblclick`,e=>t(2,...o(e)))}var Ey=.3,[Dy,Oy]=[.55,.08],ky=[.7,400];function Ay(e,t){let n=[t[0]-e.xyz_m[0],t[1]-e.xyz_m[1],t[2]-e.xyz_m[2]],r=e.map_R_camera;return[0,1,2].map(e=>r[0][e]*n[0]+r[1][e]*n[1]+r[2][e]*n[2])}function jy(e,t){let[n,r,i]=Ay(e,t);return i<Ey?null:[e.cx_px+e.fx_px*n/i+.5,e.cy_px+e.fy_px*r/i+.5]}function My(e){return e.every(e=>e!==null)?e:null}function Ny(e,{category:t,xyz_m:n,object_height_m:r}){let i=r??0,[a,o]=[n[0]-e.xyz_m[0],n[1]-e.xyz_m[1]],s=Math.hypot(a,o)||1,c=(t,r)=>{let c=t*i/2;return jy(e,[n[0]+o/s*c,n[1]-a/s*c,n[2]+r*i])},{width:l}=_e(t);return My(t===`traffic_cone`?[c(-Dy,0),c(-Dy,.05),c(-.62*Dy,.05),c(-Oy,1),c(Oy,1),c(.62*Dy,.05),c(Dy,.05),c(Dy,0)]:[c(-l,0),c(-l,1),c(l,1),c(l,0)])}function Py(e,t,n){let{major_m:r,minor_m:i,angle_rad:a}=$h(n),[o,s]=[Math.cos(a),Math.sin(a)];return My(Array.from({length:48},(n,a)=>{let[c,l]=[r*Math.cos(a*Math.PI/24),i*Math.sin(a*Math.PI/24)];return jy(e,[t[0]+c*o-l*s,t[1]+c*s+l*o,t[2]])}))}function Fy(e,t,n){let r=(t[0]-.5-e.cx_px)/e.fx_px,i=(t[1]-.5-e.cy_px)/e.fy_px,a=t=>jy(n,e.map_R_camera.map((n,a)=>(e.xyz_m[a]??0)+t*(n[0]*r+n[1]*i+n[2]))),[o,s]=[a(ky[0]),a(ky[1])];return o&&s?[o,s]:null}function Iy(e){let t=[`observed`,`empty`,`occupied`,`hidden`];return[...e.frames].sort((e,n)=>t.indexOf(e.state)-t.indexOf(n.state)||e.range_m-n.range_m)[0]}function Ly(e,t){let n=e.indexOf(t);return[...e.slice(n+1),...e.slice(0,n).reverse()]}function Ry(e,t,n){let r=n?.drive_uuid??e.now?.drive_uuid,i=t.find(e=>e.drive_uuid===r)??t[0];return i?{drive_uuid:i.drive_uuid,frame_index:i.drive_uuid===n?.drive_uuid?n.frame_index:null}:n??void 0}var zy=(e,t)=>Math.hypot((e[0]??0)-(t[0]??0),(e[1]??0)-(t[1]??0)),By=(e,t)=>t.frames.reduce((t,n)=>zy(n.camera_xyz_m,e.camera_xyz_m)<zy(t.camera_xyz_m,e.camera_xyz_m)?n:t);function Vy(e,t){let n=n=>{let r=t&&jy(e[n],t.xyz_m);return r?Math.min(r[0],e[n].width_px-r[0]):-1/0};return n(`left`)<0&&n(`right`)>0?`right`:`left`}var Hy=[[`left`,`Left`,`1`],[`right`,`Right`,`2`],[`both`,`Both`,`3`]],Uy=[[`boxes`,`Boxes`,`B`],[`cone`,`Projected cone`,`O`],[`epipolar`,`Epipolar line`,`E`]],Wy={observed:`cone observed`,empty:`position visible, no cone observed`,occupied:`another object at the position`,hidden:`position hidden`},Gy=60,Ky=220,[qy,Jy]=[.6,.3],Yy={scale:null,offset:[0,0]};function Xy(e,t){let n=by(),r=new Map,i=new Map,a=_(`b`,{class:`viewer-title`}),o=_(`p`,{class:`viewer-why`}),s=_(`select`,{aria:{label:`Drive`}}),c=_(`select`,{aria:{label:`Drive to Compare with`}}),l=_(`input`,{type:`checkbox`}),u=Hy.map(([e,t,n])=>_(`button`,{type:`button`,textContent:t,title:`${t} (${n})`,data:{value:e},onclick:()=>z(e)})),d=Uy.map(([e,t,n])=>{let r=_(`input`,{type:`checkbox`,checked:e!==`epipolar`,data:{name:e}});return r.addEventListener(`change`,()=>ye(e,r.checked)),{name:e,box:r,node:_(`label`,{class:`check`,data:{name:e}},r,t,_(`kbd`,{textContent:n}))}}),f=_(`div`,{class:`panes`}),p=_(`button`,{type:`button`,class:`step`,title:`Play (space)`,aria:{label:`Play`},onclick:()=>De(!ue)}),m=_(`input`,{type:`range`,min:`0`,step:`1`,aria:{label:`Frame pair`}}),h=_(`div`,{class:`viewer-ticks`}),v=_(`p`,{class:`viewer-text`,role:`status`,aria:{live:`polite`}}),x=(e,t,n)=>_(`button`,{type:`button`,class:`step`,textContent:t,title:n,aria:{label:n},onclick:()=>ke(e)}),C=(e,t,n)=>_(`button`,{type:`button`,title:`${e} (${t})`,textContent:e,onclick:n}),w=_(`input`,{type:`checkbox`,class:`wipe-on`,onchange:()=>Le()}),D=_(`label`,{class:`check`,title:`One over the other, with a divider (V)`},w,`Swipe`,_(`kbd`,{textContent:`V`})),O=_(`input`,{type:`range`,class:`wipe`,min:`0`,max:`100`,value:`50`,aria:{label:`Divider between before and after`},oninput:()=>xe()}),k=_(`input`,{type:`checkbox`,id:`follow`,onchange:()=>t.follow(k.checked)}),A=C(`Zoom to the cone`,`Z`,()=>Te(qy)),M=_(`label`,{class:`check`},l,`Compare with`,c,_(`kbd`,{textContent:`C`})),N=_(`dialog`,{class:`viewer`,aria:{label:`Images`}},_(`header`,{},a,o,_(`button`,{type:`button`,class:`close`,textContent:`×`,title:`Close (Esc)`,aria:{label:`Close the images`},onclick:()=>N.close()})),_(`div`,{class:`viewer-tools`},_(`div`,{class:`segmented`,role:`group`,aria:{label:`Images shown`}},...u),M,...d.map(({node:e})=>e),_(`span`,{class:`space`}),A,C(`Whole image`,`0`,()=>Se(Yy))),f,O,_(`footer`,{},_(`div`,{class:`viewer-line`},s,p,x(-1,`‹`,`Previous frame pair (←)`),_(`div`,{class:`viewer-track`},h,m),x(1,`›`,`Next frame pair (→)`),_(`button`,{type:`button`,class:`enlarge`,textContent:`Enlarge`,title:`Over the whole page, with all tools (I)`,onclick:()=>we()})),v,_(`div`,{class:`viewer-line`},D,_(`label`,{class:`check follow`,title:`The map is seen from where the image was taken (F)`},k,`Camera follows image`,_(`kbd`,{textContent:`F`})))));e.append(N);let P=null,ee=[],F=null,te=null,ne=``,re=0,ie=`both`,I=!1,ae=!1,oe=Yy,R=null,ce=!1,le=null,ue=!1,de=0,fe=0,pe=[],me=[];new ResizeObserver(()=>void(f.dataset.columns=String(Re()))).observe(f),m.addEventListener(`input`,()=>Ae(Number(m.value))),s.addEventListener(`change`,()=>void je(s.value,null)),c.addEventListener(`change`,()=>Ee(!0)),l.addEventListener(`change`,()=>Ee(l.checked)),N.addEventListener(`close`,()=>{De(!1),R&&([ie,I,ce]=[`best`,ae,!0]),H(),Fe()}),N.addEventListener(`keydown`,e=>{V()&&(e.stopPropagation(),e.ctrlKey||e.metaKey||e.altKey||e.target instanceof HTMLSelectElement||he(e)&&e.preventDefault())});function he(e){if(e.target===O&&y.test(e.key))return!1;let t=Uy.find(([,,t])=>t.toLowerCase()===e.key.toLowerCase())?.[0],n=Hy.find(([,,t])=>t===e.key)?.[0];if(t)ye(t,!ge(t));else if(n)z(n);else if(e.shiftKey&&e.key.startsWith(`Arrow`))B(e.key);else if(e.key===`ArrowLeft`)ke(-1);else if(e.key===`ArrowRight`)ke(1);else if(e.key===` `)De(!ue);else if(e.key===`+`||e.key===`=`)me[0]?.zoom(1.5);else if(e.key===`-`)me[0]?.zoom(1/1.5);else if(e.key===`0`)Se(Yy);else if(e.key.toLowerCase()===`z`)Te(qy);else if(e.key.toLowerCase()===`c`)Ee(!I);else if(e.key.toLowerCase()===`v`&&!D.hidden)w.click();else if(e.key.toLowerCase()===`f`&&Ce())k.click();else if(e.key.toLowerCase()===`i`)V()?N.close():we();else return!1;return!0}let ge=e=>d.find(t=>t.name===e)?.box.checked??!1,_e=e=>ee.find(t=>t.drive_uuid===e),ve=(e,t)=>_e(e)?.frames.find(e=>e.frame_index===t);function ye(e,t){let n=d.find(t=>t.name===e);n&&(n.box.checked=t),Le()}function z(e){ie=e,Fe()}let be=()=>w.checked&&!D.hidden;function xe(){f.style.setProperty(`--wipe`,`${100-Number(O.value)}%`),O.setAttribute(`aria-valuetext`,`${O.value} % before`)}function Se(e){oe=e;for(let e of me)e.setView(oe);N.dataset.scale=oe.scale===null?`fit`:oe.scale.toFixed(2)}function B(e){let[t,n]={ArrowLeft:[1,0],ArrowRight:[-1,0],ArrowUp:[0,1]}[e]??[0,-1];me[0]?.pan((t??0)*Gy,(n??0)*Gy)}let Ce=()=>R!==null&&!V(),V=()=>N.matches(`:modal`);function H(){N.classList.toggle(`docked`,R!==null),(R??e).append(N),N.toggleAttribute(`open`,R!==null&&P!==null),Le()}function we(){!V()&&P&&(N.removeAttribute(`open`),N.classList.remove(`docked`),N.showModal(),R&&([ie,I]=[`both`,!1]),l.checked=I,Se(Yy),Fe(),p.focus())}function Te(e){let t=pe[0],n=t&&P?.now&&Ny(t.frame[t.side],P.now);if(!n)return;let r=n.map(([,e])=>e),i=Math.min(Ky,e*(me[0]?.node.clientHeight||Ky)),a=me[0]?.fit()??1;Se({scale:Math.min(Math.max(i/(Math.max(...r)-Math.min(...r)),a),24),offset:[0,0]})}function Ee(e){I=e&&c.options.length>0,l.checked=I,te=null,Fe()}function De(e){ue=e,p.textContent=ue?`❚❚`:`▶`,p.setAttribute(`aria-label`,ue?`Pause`:`Play`),window.clearTimeout(de),ue&&Oe(0)}function Oe(e){de=window.setTimeout(()=>{let e=F?.frame_index.length??0;if(!ue||!F)return;if(re>=e-1)return De(!1);let[t,n]=[F.captured_at[re],F.captured_at[re+1]],r=t&&n?Date.parse(n)-Date.parse(t):100,i=performance.now();re+=1,Fe().then(()=>ue&&Oe(Math.max(r-(performance.now()-i),0)))},e)}function ke(e){De(!1),Ae(re+e)}function Ae(e){let n=F?.frame_index.length??0;re=Math.min(Math.max(e,0),Math.max(n-1,0));let r=F?.frame_index[re];r!==void 0&&t.walked({drive_uuid:ne,frame_index:r}),Fe()}async function je(e,t){if(!P)return;De(!1),ne=e,s.value=e;let{map:n,id:r}=P,i=await We(n,e);if(P?.id!==r||ne!==e)return;F=i;let a=_e(e),o=t??(a&&Iy(a)?.frame_index)??P.stops?.find(t=>t.drive_uuid===e)?.frame_index??-1;ce=!0,re=Math.max(F.frame_index.indexOf(o),0),m.max=String(Math.max(F.frame_index.length-1,0));let c=Math.max(F.frame_index.length-1,1);b(h,...(a?.frames??[]).map(e=>{let t=_(`i`,{class:e.state});return t.style.left=`calc(8px + (100% - 16px) * ${(F?.frame_index.indexOf(e.frame_index)??0)/c})`,t})),Me(),await Fe()}function Me(){let e=_e(ne),t=e?Ly(ee,e):ee,n=c.value;b(c,...t.map(e=>_(`option`,{value:e.drive_uuid,textContent:`${e.captured_from<(_e(ne)?.captured_from??``)?`before`:`after`}: ${Ne(e)}`}))),t.some(e=>e.drive_uuid===n)&&(c.value=n),l.disabled=c.disabled=!t.length,t.length||(I=l.checked=!1),te=null}let Ne=e=>`${e.drive_id} · ${e.kind?L[e.kind].label:`not evaluated`}${e.counts?``:` · not part of the map`}`;async function Pe(e){let t=_e(c.value);if(!P||!t||!F)return null;let r=ve(ne,e);if(r)return n.frame(P.map,t.drive_uuid,By(r,t).frame_index);let i=F.xyz_m[re];if(!i)return null;te??=await We(P.map,t.drive_uuid);let a=te.xyz_m,o=a.reduce((e,t,n)=>zy(t,i)<zy(a[e]??t,i)?n:e,0);return n.frame(P.map,t.drive_uuid,te.frame_index[o]??0)}async function Fe(){if(!P||!F)return;let e=++fe,{map:t,id:r}=P,i=F.frame_index[re];if(i!==void 0){m.value=String(re),N.classList.add(`busy`);try{let[a,o]=await Promise.all([n.frame(t,ne,i),I?Pe(i):null]),s=(e,t)=>Ue(e).map(n=>({frame:e,side:n,title:t})),c=[...o?s(o,o.captured_at<a.captured_at?`before`:`after`):[],...s(a,o?`this drive`:``)],l=await Promise.all(c.map(e=>n.image(t,e.frame,e.side,r)));if(e!==fe)return;pe=c.map((e,t)=>({...e,image:l[t]??{url:null,problem:null}})),Le(),Ie()}catch(t){e===fe&&(v.textContent=j(t))}finally{e===fe&&N.classList.remove(`busy`)}}}function Ie(){let{map:e,id:t}=P;for(let r of F?.frame_index.slice(re+1,re+(ue?5:2))??[])n.frame(e,ne,r).then(r=>Ue(r).map(i=>n.image(e,r,i,t)),()=>void 0)}function Le(){if(!P||!F)return;for(;me.length<pe.length;){let e=wy({view:Se,pick:t=>ze(e,t)});me.push(e)}me=me.slice(0,pe.length),D.hidden=new Set(pe.map(e=>e.title)).size<2,O.hidden=!be();let e=be()?me.slice(0,me.length/2).map((e,t)=>_(`div`,{class:`pair`},e.node,me[t+me.length/2]?.node)):me.map(e=>e.node);b(f,...e),f.dataset.count=String(e.length),f.dataset.columns=String(Re()),pe.forEach((e,t)=>me[t]?.show(Be(e),oe)),ce&&Ce()&&(P.now?Te(Jy):Se(Yy)),ce=!1;for(let e of u)e.setAttribute(`aria-pressed`,String(e.dataset.value===ie));let[n,r]=[pe.at(-1)?.frame,pe.at(-1)?.side??`left`];if(t.camera(n?.[r]??null),!n)return;let i=ve(n.drive_uuid,n.frame_index);N.dataset.item=P.title,N.dataset.frame=`${n.drive_id} ${n.frame_index}`,b(v,_(`b`,{textContent:n.drive_id}),` · frame pair ${n.frame_index} (${re+1} of ${F.frame_index.length}) · ${T(n.captured_at)}`,P.now&&` · `,P.now&&(i?`${i.range_m.toFixed(1)} m away, ${Wy[i.state]}`:`position not in view`),n.pixelated&&_(`small`,{textContent:` · pixelated outside detections (logins with the role review see all)`}))}function Re(){let e=pe[0]?.frame.left,t=f.children.length;if(!e||t===1)return 1;if(t===4)return 2;let[n,r]=[f.clientWidth/e.width_px,f.clientHeight/e.height_px];return Math.min(n/2,r)>=Math.min(n,r/2)?2:1}function ze(e,t){let n=pe[me.indexOf(e)];n&&(le={drive:n.frame.drive_uuid,index:n.frame.frame_index,side:n.side,point:t},ye(`epipolar`,!0))}function Be({frame:e,side:t,image:n,title:r}){let{now:i}=P,a=e[t],o=i&&jy(a,[i.xyz_m[0],i.xyz_m[1],i.xyz_m[2]+(i.object_height_m??0)/2]),s=o?[Math.min(Math.max(o[0],0),a.width_px),Math.min(Math.max(o[1],0),a.height_px)]:[a.width_px/2,a.height_px/2];return{...n,anchor:s,size:[a.width_px,a.height_px],alt:`${t} image of frame pair ${e.frame_index} of ${e.drive_id}`,caption:Ce()?`${r||t} · ${S(e.captured_at,!1)} UTC`:[t,r&&`${r}: ${e.drive_id}`,r&&S(e.captured_at,!1)].filter(Boolean).join(` · `),shapes:Ve(e,t)}}function Ve(e,t){let{now:n,before:r,sightings:i}=P,a=e[t],o=new Set(i.filter(t=>t.drive_uuid===e.drive_uuid&&t.frame_index===e.frame_index).map(e=>e.match_index)),s=[];if(ge(`boxes`))for(let e of a.boxes){let[t,n]=[e.x_px+e.w_px,e.y_px+e.h_px],r=e.match_index!==null&&o.has(e.match_index);s.push({points:[[e.x_px,e.y_px],[t,e.y_px],[t,n],[e.x_px,n]],style:r?`box chosen`:`box`,text:Ce()?``:e.score?.toFixed(2)??``})}if(n&&ge(`cone`)){let e=o.size?`cone`:`cone dashed`,t=(e,t,n)=>e&&s.push({points:e,style:t,...n?{text:n}:{}});t(Ny(a,n),e,o.size?void 0:se(n.kind)?`removed`:`expected`),t(Py(a,n.xyz_m,n.cov_m2),`ellipse`),r&&t(Ny(a,r),`cone dashed old`,`before the move`)}return ge(`epipolar`)&&s.push(...He(e,t)),s}function He(e,t){let n=le&&le.drive===e.drive_uuid&&le.index===e.frame_index?le:null,r=n?.side??`left`,{now:i}=P,a=n?.point??(i&&jy(e[r],i.xyz_m));if(!a)return[];if(t===r){let[e,t]=a;return[{points:[[e-6,t],[e+6,t]],style:`epipolar`,closed:!1},{points:[[e,t-6],[e,t+6]],style:`epipolar`,closed:!1}]}let o=Fy(e[r],a,e[t]);return o?[{points:o,style:`epipolar`,closed:!1}]:[]}let Ue=e=>ie===`both`?[`left`,`right`]:[ie===`best`?Vy(e,P?.now??null):ie];function We(e,t){let n=i.get(t)??g.trajectory(e,t);return i.set(t,n),n.catch(()=>i.delete(t)),n}let Ge=({map:e,id:t,now:n})=>`${e} ${t} ${n?.version}`;async function Ke(e){if(e.id===null||!e.now)return[];let t=Ge(e),n=r.get(t)??g.passes(e.map,e.id,e.isLast?null:e.now.version).then(e=>e.passes);return r.delete(t),n}async function qe(e,t){let n=P?.map===e.map&&P.id===e.id;P=e,le=null,n||([ee,F,pe]=[[],null,[]]),!n&&R&&b(f),A.hidden=M.hidden=e.now===null;for(let{name:t,node:n}of d)n.hidden=t===`cone`&&e.now===null;b(a,e.title),o.textContent=o.title=e.why,v.textContent=`Loading …`;try{let n=await Ke(e);if(P!==e)return;ee=n,e.now?b(s,...ee.map(e=>_(`option`,{value:e.drive_uuid,textContent:`${Ne(e)} · ${E(e.frames.length,`frame pair`)}`}))):b(s,...(e.stops??[{drive_uuid:t?.drive_uuid??``,title:e.title}]).map(e=>_(`option`,{value:e.drive_uuid,textContent:e.title})));let r=Ry(e,ee,t);if(r)return await je(r.drive_uuid,r.frame_index);v.textContent=`No drive has images of this position: its records were deleted, or the map was imported.`}catch(t){P===e&&(v.textContent=j(t))}}return{get covers(){return V()},key:he,step:ke,follows:e=>void(k.checked=e),get dock(){return R},dockIn(e){V()&&N.close(),R=e,H()},async show(e,t,n){ae=n,V()||([ie,I]=[`best`,n]);let r=qe(e,t);H(),l.checked=I,await r},clear(){[P,F,pe]=[null,null,[]],t.camera(null),V()||H()},async preload(e,t,i){let a=Ke(e);r.set(Ge(e),a),a.catch(()=>r.delete(Ge(e)));let o=await a,s=Ry(e,o,t);if(!s)return;let c=o.find(e=>e.drive_uuid===s.drive_uuid),l=c&&(c.frames.find(e=>e.frame_index===s.frame_index)??Iy(c)),u=i&&c?Ly(o,c)[0]:void 0,d=[[s.drive_uuid,l?.frame_index??s.frame_index??0],...l&&u?[[u.drive_uuid,By(l,u).frame_index]]:[]];await Promise.all([We(e.map,s.drive_uuid),...d.map(async([t,r])=>{let i=await n.frame(e.map,String(t),Number(r));await n.image(e.map,i,Vy(i,e.now),e.id)})])},cover:we}}var Zy=.03,Qy=`#f2a900`,[$y,eb]=[`#c9184a`,`#2b7de1`];function tb(e,t,n,r){let i=_(`div`,{class:`zones ${r}`});t.append(i);let a=new fi;e.scene.add(a);let o=new Map,s=[];function c(e){let t=o.get(e)??{area:new Aa({color:e,transparent:!0,opacity:.28,side:2,depthWrite:!1}),edge:new so({color:e})};return o.set(e,t),t}return e.beforeDraw(()=>{let t=[],{clientWidth:n,clientHeight:i}=e.canvas;for(let{corners:a,node:o}of s){let s=a.map(t=>e.project(t)).filter(e=>e&&e[0]>0&&e[0]<n&&e[1]>30&&e[1]<i-30).reduce((e,t)=>t&&(!e||(r===`below`?t[1]>e[1]:t[1]<e[1]))?t:e,null);if(o.hidden=!s||t.some(([e,t])=>Math.abs(e-s[0])<180&&Math.abs(t-s[1])<24),o.hidden||!s)continue;t.push(s);let c=r===`below`?`+ 8px`:`- 8px - 100%`;o.style.transform=`translate(clamp(4px, ${Math.round(s[0])}px - 50%, ${n-4}px - 100%), calc(${Math.round(s[1])}px ${c}))`}}),function(t){for(let e of a.children)(e instanceof Ha||e instanceof xo)&&e.geometry.dispose();a.clear(),i.replaceChildren(),s=[];for(let{corners:e,colour:n,words:r}of t){let t=(e[0]?.[2]??0)+Zy,o=new Ha(new ec(new ms(e.map(([e,t])=>new K(e,t)))).translate(0,0,t),c(n).area);o.renderOrder=1,a.add(o,new xo(new ma().setFromPoints(e.map(([e,n])=>new q(e,n,t))),c(n).edge)),r&&s.push({corners:e,node:i.appendChild(_(`span`,{class:`zone`,hidden:!0,textContent:r}))})}document.documentElement.dataset[n]=String(s.length),e.draw()}}function nb(e,t){let n=tb(e,t,`zones`,`below`),r=0;return{async open(e,t){let i=++r,{zones:a}=await g.zones(e,t);i===r&&n(a.map(e=>({corners:ib(e.ring_m),colour:Qy,words:ob(e)})))},close(){r+=1,n([])}}}function rb(e,t,n){let r=tb(e,t,`differences`,`above`);return{show(e,t){let i=t===null?Date.now():Date.parse(t),a=e.filter(e=>e.rank!==null&&e.verdict!==`wrong`&&(e.from_at===null||Date.parse(e.from_at)<=i)&&(e.until_at===null||Date.parse(e.until_at)>=i));r(a.flatMap(e=>{let t=e.plan_rings_m.map(t=>({corners:ab(t,e.at_m[2]??n(e.at_m[0],e.at_m[1])),colour:eb,words:``})),[r,...i]=[...e.zone_ring_m.length?[{corners:ib(e.zone_ring_m),colour:$y,words:``}]:[],...t];return r?[{...r,words:Qg(e)},...i]:[]}))}}}var ib=e=>Array.from({length:e.length/3},(t,n)=>e.slice(3*n,3*n+3)),ab=(e,t)=>Array.from({length:e.length/2},(n,r)=>[e[2*r]??0,e[2*r+1]??0,t]);function ob(e){let t=e.closed_lane_count===null?`closed`:e.closed_lane_count===0?`no lane closed`:`${E(e.closed_lane_count,`lane`)} closed`;return`Work zone · ${e.closed_side===null?``:`${t} on the ${e.closed_side} · `}${Math.round(e.length_m)} m`}var Q=hg(document.getElementById(`app`)??document.body);r(()=>Q.logIn(a)),Q.card(`Loading the map …`,``,{busy:!0});var sb=Ze(()=>$,e=>Q.toast(e,{text:`OK`,run:()=>void 0})),$=sb.read();try{let e=await g.maps(),t=$.map||ex(e);e.maps.some(e=>e.map_name===t&&e.changeset_count>0)&&m(t,e)}catch{}var cb;try{cb=W_(Q.view)}catch(e){throw Q.card(`The map cannot be drawn`,`This browser has no WebGL. Turn on hardware acceleration in its settings, or use another browser.`),e}var lb=Jm(cb),ub=mm(cb),db=_m(cb),fb=bm(cb,Q.view),pb=bm(cb,Q.view,`of-changes`,`Δ `),mb=nb(cb,Q.view),hb=rb(cb,Q.view,(e,t)=>Cx(e,t)),gb=ng(cb,Q.view),_b=fp(cb,e=>Q.toast(`Base layers: ${j(e)}`,null)),vb=vy(cb,Q.view,lb,{state:()=>$,change:e=>{$={...$,scene:{...$.scene,...e}},sb.writeChoice(),_b.apply($),vb.apply($)},cones:()=>bx(),paper:e=>void jx(e),trouble:e=>Q.toast(e,null),redraw:()=>Ex()}),yb=6,bb=[],xb=!1,Sb=null,Cb=[],wb=new Map,Tb=!1,Eb=[],Db=null,Ob=0,kb=null,Ab=[],jb=null,Mb=new Map,Nb=hv(Q.sidebar,{chooseMap:e=>{$={...Ye(``),map:e},sb.write(),tx()},change:Jb,fit:()=>kx()}),Pb=wv(Nb.sites,e=>cb.fit(e)),Fb=Q_(Q.tools.search,{search:e=>g.search($.map,e),select:e=>void Vb(e,!0),showChangeset:e=>Jb({mode:`drive`,changeset:e===Sb?.changesets.at(-1)?.changeset_no?null:e}),flyTo:({xy_m:[e,t]})=>{$.mark=[e,t],sb.write(),cb.lookAt([e,t,Cx(e,t)],40),wx()}}),Ib=ev(cb,Q.view,()=>{$.mark=null,sb.write(),wx()}),Lb=Mg(Q.listPane,{change:Jb,withDecisions:fx,select:(e,t)=>void Vb(e,t),area:()=>dm(cb,Sb?.origin_m??[0,0,0]),failed:e=>Q.toast(`The list cannot be read: ${j(e)}`,null)});Vh(Q.tools.download,{shown:()=>Sb?.changesets.length&&Jp($,Sb.changesets)===null?{map:$.map,drive:$.mode===`drive`?$b($.changeset)??null:null,coneCount:ub.count(),box:Sx(),...Yp($,Sb.changesets)}:null,picture:()=>new Promise((e,t)=>{cb.draw(),requestAnimationFrame(()=>void Gh(cb.canvas,Q.view,`${$.map}, ${Yp($,Sb?.changesets??[]).title}`).then(e,t))}),failed:e=>Q.toast(e,null)});var Rb=Yv(Q.timeline,{change:Jb,showChanges:(e,t)=>Jb({mode:`drive`,changeset:e,side:`changes`,hidden:Pe({...$,hidden:$.list===`changes`?$.hidden:new Set},t),list:`changes`}),writableMap:()=>kb?.decides_drives?$.map:null,decided:()=>void sx(),decisions:()=>kb?.decisions??[]}),zb=Xy(document.body,{walked:e=>Bb.walked(e),camera:e=>Bb.camera(e),follow:Ax}),Bb=mv(Q.panel,cb,gb,zb,{state:()=>$,timeline:()=>Sb,decisions:()=>kb,cones:()=>Cb,writeAddress:sb.write,writeChoice:sb.writeChoice,chosen:e=>{gb.showLabels(bx(),e),Lb.choose(),Q.panelOpen(e!==null)},decided:()=>void sx(),showChangeset:e=>Jb({mode:`drive`,changeset:e})}),{select:Vb}=Bb;zb.dockIn(Bb.images);var Hb=e=>({map:()=>$.map,writable:()=>kb?.writable??!1,opened:t=>{$.list=t?e:null,sb.write(),t||zb.dockIn(Bb.images),t||Bb.draw()},said:e=>Q.toast(e,null)}),Ub=n_(Q.app,zb,Hb(`review`),Wg({map:()=>$.map,decidesDrives:()=>kb?.decides_drives??!1,show:e=>{Jb({mode:`drive`,side:`changes`,changeset:e.changeset_no===Sb?.changesets.at(-1)?.changeset_no?null:e.changeset_no}),Vb(e.feature_id,!0)},subject:async e=>{if(e.feature_id!==null)return fv($.map,e.feature_id,e.changeset_no);let{drive_uuid:t}=Sb?.changesets.find(t=>t.changeset_no===e.changeset_no)??{drive_uuid:``};return[{map:$.map,id:null,title:e.drive_id,why:e.why,now:null,isLast:!0,before:null,sightings:[]},{drive_uuid:t,frame_index:0}]},decided:()=>void sx()})),Wb=n_(Q.app,zb,Hb(`differences`),Jg({map:()=>$.map,rows:(e,t)=>{Ab=e,Wb.button.hidden=t===0,ux()},show:e=>{Jb({mode:`instant`,valid:e.until_at===null?null:Yg(e)[0]?.at??e.passed_at,known:null,mark:null}),Vb(null);let[t,n,r]=e.at_m;cb.lookAt([t,n,r??Cx(t,n)],Math.max(40,2.5*e.radius_m))},subject:async e=>{let t=Yg(e).map((e,t)=>({...e,title:`${t?`first`:`last`} seen by ${e.drive_id}`}));return[{map:$.map,id:null,title:e.kind,why:e.text,now:null,isLast:!0,before:null,sightings:[],stops:t},t[0]??null]},decided:()=>Wb.load()}));Wb.button.hidden=!0;var Gb=[Ub,Wb];Q.brand.after(Ub.button,Wb.button);var Kb=_(`section`,{class:`decisions`,hidden:!0});Q.sidebar.append(Kb);var qb=Rh(Kb,e=>{let t=Sb?.changesets.find(t=>t.changeset_id===e.changeset_id);t?Jb({mode:`drive`,changeset:t.changeset_no}):e.feature_id&&Vb(e.feature_id,!0)});function Jb(e,t=!0){$={...$,...e},sb.writeChoice(),t?cx():Ex()}var Yb=0;function Xb(){window.clearTimeout(Yb),Yb=window.setTimeout(()=>{Lb.moved(),vb.moved(),Db&&px()},120)}Q.listPane.onChange(e=>{$.list=e,sb.write()}),cb.onCamera(e=>{$.camera=e,sb.writeAtRest(),Xb()}),new ResizeObserver(Xb).observe(Q.view),window.addEventListener(`hashchange`,()=>{let e=sb.read(),t=e.map!==$.map;$=e,t?tx():($.camera&&vb.setPose($.camera),vb.openMeasure(),cx(),Vb($.feature),Qb())});function Zb(){for(let e of Gb)e.load()}function Qb(){let e=Gb.find(e=>e.id===$.list);for(let t of Gb)t!==e&&t.set(!1);e?.set(!0)}var $b=e=>Up(Sb?.changesets??[],e);function ex(e){return e.maps.some(t=>t.map_name===e.chosen)||!e.maps[0]?e.chosen:e.maps[0].map_name}async function tx(){jb?.(),Bb.clear(),Sb=Db=null,Cb=[],ub.close(),db.close(),Mb.clear(),kb=null,qb(null),_b.close(),mb.close(),Ab=[],Wb.button.hidden=!0,Nb.showBase([]),Tb=$.camera!==null,Q.card(`Loading the map …`,``,{busy:!0});try{let e=await g.maps();bb=e.maps,xb=e.embeddable,$.map||($.map=ex(e)),vb.basemap(e.basemap),Nb.showMaps(bb,$.map),document.title=`${$.map} · conetl`,bb.some(e=>e.map_name===$.map&&e.changeset_count>0)&&(nx($.map),cb.warm(),await Promise.all([rx(),ax()])),$.camera&&vb.setPose($.camera),await cx(),vb.openMeasure(),$.feature&&await Vb($.feature),Sb&&Zb(),Qb()}catch(e){Mx(e,tx)}let e=null,t=null,n=$.map;jb=Ig(n,{newest:e=>void ix(e),decided:t=>{e!==null&&t!==e&&sx(),e=t},base:e=>{t!==null&&e!==t&&nx(n),t=e},status:(e,t)=>{Q.status(e,t),Q.notice(e===`live`||Db===null?null:t)}})}async function nx(e){try{_b.apply($);let t=await _b.open(e);e===$.map&&Nb.showBase(t),vb.points(t.some(e=>e.kind===`points`))}catch(t){Q.toast(`The base layers cannot be shown: ${j(t)}`,{text:`Try again`,run:()=>void nx(e)})}}async function rx(){Sb=await g.timeline($.map),vb.open(Sb)}async function ix(e){if(!(e<=(Sb?.changesets.at(-1)?.changeset_no??0)))try{await Promise.all([rx(),ax()]),Zb();let e=Sb?.changesets.at(-1);if(!e)return;ox();let t=Jv([e]).map(e=>e.text).join(`, `)||`no changes`,n=$.mode===`drive`&&$.changeset===null,r=e.counts?`${e.drive_id} was saved: ${t}.`:e.hold===null?`${e.drive_id} was saved, but is not part of the map: see the decisions.`:`${e.drive_id} is on hold: ${e.hold}`;Q.toast(r,n?null:{text:`Show its changes`,run:()=>Jb({mode:`drive`,changeset:null,side:`changes`})}),await cx(),await Bb.again()}catch(t){Mx(t,()=>ix(e))}}async function ax(){let e=$.map;try{let t=await g.decisions(e);if(e!==$.map)return;kb=I?{...t,writable:!1,decides_drives:!1}:t,Dh.logIn(t.person),Q.person(t.person),qb(t)}catch(e){Q.toast(`The decisions cannot be read: ${j(e)}`,{text:`Try again`,run:()=>void sx()})}}async function ox(){bb=(await g.maps()).maps,Nb.showMaps(bb,$.map)}async function sx(){try{await Promise.all([rx(),ax(),ox()]),Zb(),await cx(),await Bb.again()}catch(e){Mx(e,sx)}}async function cx(){let e=++Ob;if(!Sb||!Sb.changesets.length){let e=bb.filter(e=>e.changeset_count>0).map(e=>`“${e.map_name}”`),t=e.length>0&&!bb.some(e=>e.map_name===$.map),n=t?`There is no map “${$.map}”`:`The map “${$.map}” is empty`,r=t?`Select one of the maps of this database: ${e.join(`, `)}. To create a new map, ingest a drive:`:`Ingest a drive; it appears here at once:`;Q.card(n,r,{code:`conetl ingest ${$.map==="default"?``:`--map ${$.map} `}path/to/drive`}),Q.empty(!0),mx();return}Q.empty(!1);let t=Jp($,Sb.changesets);if(t!==null){let e=Sb.changesets.map(e=>e.changeset_no),n=e.length===1?`It has one changeset, number ${e[0]}.`:`It has ${e.length} changesets, numbers ${e.length>8?`${e[0]} to ${e.at(-1)}`:e.join(`, `)}.`;mx(),Q.card(`The map “${$.map}” has no changeset ${t}`,n,{action:{text:`Show the latest`,run:()=>Jb({changeset:null,from:0,to:null,known:null})}});return}Q.busy(!0);let n=$;Rb($,Sb.changesets);try{let[t]=await Promise.all([dx(rm($,Sb.changesets)),ub.open($.map,Yp($,Sb.changesets).at),db.open($.map,Sb.origin_m,Xp($,Sb.changesets))]);if(e!==Ob)return;!Tb&&!ub.isWhole()&&(Tb=!0,Cb=[],kx());let[r]=await Promise.all([ub.isWhole()?[]:ub.overview(),ub.load(),db.load()]);if(e!==Ob)return;Eb=r,lx(n),Q.card(null),Bb.follow(),yx(t),Db=n}catch(t){e===Ob&&Mx(t,()=>Jb(n))}finally{e===Ob&&Q.busy(!1)}}async function lx(e){try{ux(),e.mode===`instant`&&e.known===null?await mb.open(e.map,e.valid):mb.close()}catch(e){Q.toast(`Work zones cannot be shown: ${j(e)}`,null)}}function ux(){hb.show($.mode===`instant`&&$.known===null?Ab:[],$.valid)}function dx(e){return Promise.all(e.map(async({drive_uuid:e})=>{let t=Mb.get(e)??await g.trajectory($.map,e);return Mb.set(e,t),t}))}function fx(e){let t=(kb?.decisions??[]).filter(e=>e.kind===`suppress`||e.kind===`classify`);return t.length?e.map(e=>{let n=Oh(t,e.id,e.xyz,e.marking!==null),r=n.find(t=>t.found_as===e.category)?.category??e.category;return{...e,category:r,kind:n.some(e=>e.kind===`suppress`)?`suppressed`:e.kind}}):e}async function px(){let e=Ob;try{(await Promise.all([ub.load(),db.load()])).some(Boolean)&&e===Ob&&_x()}catch(e){Mx(e,px)}}function mx(){ub.close(),db.close(),yx([])}function hx(){let e=new Map(ub.isWhole()?[]:Object.entries(ub.summary()?.categories??{}));if(e.size)for(let{category:t}of ub.shown().cones)e.set(t,(e.get(t)??0)-1);return e}var gx=()=>db.isOpen()&&($.mode!==`drive`||$.side!==`before`);function _x(){let e=ub.shown().cones,t=gx()?Zp(e,db.shown(),$,Sb?.changesets??[]):e;Cb=$.mode===`drive`?fx(t):t,vx(t),xe(Cb,hx()),Ex()}function vx(e){if(wb=new Map(gx()?db.kinds():[]),$.mode===`drive`&&$.side===`after`)for(let e of wb.keys())se(e)&&wb.delete(e);wb.set(Tx(),Math.max(ub.count()-(gx()?db.standing():0),0));for(let[t,{kind:n}]of e.entries())Cb[t]?.kind===`suppressed`&&(wb.set(n,(wb.get(n)??0)-1),wb.set(`suppressed`,(wb.get(`suppressed`)??0)+1))}function yx(e){_x(),gb.showPaths(e),cb.start();let t=(Cb.length?Cb.map(e=>e.xyz[2]):ub.shown().clusters.map(e=>e.xyz_m[2])).sort((e,t)=>e-t),n=t[Math.floor(t.length/2)];n!==void 0&&n!==cb.ground&&(cb.setGround(n),Ex()),!Tb&&(Cb.length||e.length)&&(Tb=!0,kx())}function bx(){return Cb.filter(Ae($))}function xx(e){let t=cb.project(e);return t!==null&&t[0]>=0&&t[1]>=0&&t[0]<=cb.canvas.clientWidth&&t[1]<=cb.canvas.clientHeight}function Sx(){let[e,t]=Sb?.origin_m??[0,0],[n,r,i,a]=(ub.isWhole()?Cb.map(e=>e.xyz).filter(xx):Bp(cb)).reduce(([e,t,n,r],[i,a])=>[Math.min(e,i),Math.min(t,a),Math.max(n,i),Math.max(r,a)],[1/0,1/0,-1/0,-1/0]);return Number.isFinite(n)?[n+e-.5,r+t-.5,i+e+.5,a+t+.5]:null}function Cx(e,t){let[n,r]=[1/0,cb.ground];for(let{xyz:i}of Cb){let a=Math.hypot(i[0]-e,i[1]-t);a<n&&([n,r]=[a,i[2]])}return r}function wx(){Ib($.mark?[...$.mark,Cx(...$.mark)]:null)}var Tx=()=>gx()?`unchanged`:`standing`;function Ex(){up($.scene.paper);let e=bx();lb.show(e),Nx.shown(e),Q.listPane.open(Gb.some(e=>e.id===$.list)?null:$.list),Lb.show($,{map:$.map,timeline:Sb,features:Dx(),changes:Xp($,Sb?.changesets??[]),featureCount:ub.count(),kinds:db.kinds(),version:Ob}),Pb(ub.isWhole()?Cb.filter(e=>!e.marking):null),Ox(),wx(),_b.apply($),vb.show(ub.isWhole()?Cb:Eb.map(e=>({xyz:e,kind:Tx()}))),vb.apply($),zb.follows($.scene.follow),gb.showLabels(e,$.feature),Nb.show($,Cb,e.length,wb,ub.isWhole()?0:[...wb.values()].reduce((e,t)=>e+t,0)-Cb.length),Rb($,Sb?.changesets??[]),Bb.draw(),document.documentElement.dataset.cones=String(e.length)}function Dx(){let{at:e}=Yp($,Sb?.changesets??[]);return{valid_at:e.valid,known_at:e.known}}function Ox(){let e=e=>!$.filter.hiddenClasses?.includes(e)&&!$.hidden.has(Tx()),t=(e,t)=>Object.entries(e).reduce((e,[n,r])=>e+(t(n)?r:0),0),n=ub.shown().clusters.map(({xyz_m:n,categories:r})=>({xyz_m:n,count:t(r,e)}));fb.show(n),document.documentElement.dataset.clustered=String(n.reduce((e,{count:t})=>e+t,0));let r=gx()?db.shown().clusters:[];pb.show(r.map(({xyz_m:e,kinds:n})=>({xyz_m:e,count:t(n,e=>e!==`confirmed`&&!$.hidden.has(e))})))}function kx(){let e=[...Mb.values()].at(-1)?.xyz_m??[],[t=0,n=0,r=0,i=0]=ub.summary()?.box_m??[],a=[t,r].flatMap(e=>[n,i].map(t=>[e,t,cb.ground])),o=ub.isWhole()?Cb.flatMap(e=>[e.xyz,...e.old?[e.old]:[]]):a,s=e.filter(bv(o,7)),[c,l]=[e[0],e.at(-1)];if(c&&l&&$.camera===null){let e=Math.atan2(l[1]-c[1],l[0]-c[0]);cb.setPose([c[0],c[1],c[2],e-Math.PI/2+.5,.95,30])}cb.fit([...o,...o.length?s:e])}function Ax(e){Jb({scene:{...$.scene,follow:e,plan:$.scene.plan&&!e}},!1),Bb.followImage()}async function jx(e){let t=Sb?.changesets??[],n=$.mode===`drive`&&$.changeset!==null?$b($.changeset):t.filter(e=>e.counts).at(-1),r=t.findIndex(e=>e===n),i={...$.scene,paper:e,swipe:e?`split`:null};$=e?{...$,mode:`compare`,from:t[r-1]?.changeset_no??0,to:r===t.length-1?null:n?.changeset_no??null,known:null,points:!0,lines:!0,scene:i}:{...$,mode:`instant`,valid:null,scene:i},sb.writeChoice(),await cx();let a=bx().filter(e=>!jm(e.kind));e&&a.length&&cb.fit(a.flatMap(({xyz:[e,t,n]})=>[-6,yb].flatMap(r=>[[e+r,t,n],[e,t+r,n]])))}function Mx(e,t){if(cb.start(),Db){let{mode:n,changeset:r,side:i,from:a,to:o,valid:s,known:c}=Db;return $={...$,mode:n,changeset:r,side:i,from:a,to:o,valid:s,known:c},sb.write(),Q.busy(!1),Rb($,Sb?.changesets??[]),Q.toast(`${j(e)} The map still shows what it showed before.`,{text:`Try again`,run:()=>void t()})}Cb.length||Q.empty(!0),Q.busy(!1);let n=j(e);Q.card(`The map cannot be shown`,n,{action:{text:`Try again`,run:()=>void t()}})}var Nx=cg(cb,Q,vb,{select:e=>void Vb(e),key:Fx,click:Px,covering:(e,t)=>Gb.find(e=>e.isOpen)?.key(e,t)??null});function Px(e,t){let n=fb.pick(e,t)??pb.pick(e,t);return n&&cb.lookAt(n,cb.pose()[5]/4),n!==null}function Fx(e){if(I&&`rRdDlL/?`.includes(e.key))return!1;let t=Sb?.changesets??[],n=t.findIndex(e=>e===$b($.changeset)),r=e=>{let r=t[n+e];r&&Jb({mode:`drive`,changeset:r===t.at(-1)?null:r.changeset_no})};switch(e.key){case`Home`:return kx(),!0;case`,`:return r(-1),!0;case`.`:return r(1),!0;case`b`:case`B`:return Jb({mode:`drive`,side:$.side===`before`?`after`:`before`}),!0;case`c`:case`C`:return Jb({mode:`drive`,side:`changes`}),!0;case`n`:case`N`:return zb.step(1),!0;case`p`:case`P`:return zb.step(-1),!0;case`i`:case`I`:return zb.cover(),!0;case`v`:case`V`:case`f`:case`F`:return zb.key(e);case`1`:return Jb({points:!$.points},!1),!0;case`2`:return Jb({lines:!$.lines},!1),!0;case`r`:case`R`:return Ub.set(!0),!0;case`d`:case`D`:return Wb.button.hidden||Wb.set(!0),!0;case`l`:case`L`:return Q.listPane.toggle(),!0;case`]`:case`j`:case`J`:case`[`:case`k`:case`K`:return Lb.next(e.key===`]`||e.key.toLowerCase()===`j`?1:-1).then(e=>e&&Vb(e.id,!0),e=>Q.toast(j(e),null)),!0;case`/`:return Fb.focus(),!0;case`?`:return Q.openHelp(),!0;default:return!1}}window.conetlProject=e=>{let t=Cb.find(t=>t.id===e);return t?cb.project([t.xyz[0],t.xyz[1],t.xyz[2]+t.height_m/2]):null},window.conetlPickTime=(e,t)=>{let n=performance.now();return vb.pick(e,t),performance.now()-n},b(Q.brand,_(`b`,{textContent:`conetl`}),` map`),Q.tools.more.prepend(ae({write:sb.write,mayEmbed:()=>xb,said:Q.toast}),dp()),tx();