// The site's own search, outside a browser: node site_search.mjs WORKER INDEX < QUERIES (JSON) > PAGES (JSON)
// Prints for each query the pages that the search lists, in order.
import { readFileSync } from "node:fs";
import vm from "node:vm";

const [worker, index] = process.argv.slice(2);
const waiting = [];
let listen;
const world = {
  console, URL, setTimeout,
  addEventListener: (kind, handler) => { listen = handler; },
  postMessage: (message) => waiting.shift()(message),
};
world.self = world;
vm.runInContext(readFileSync(worker, "utf8"), vm.createContext(world));
const ask = (message) => new Promise((answer) => { waiting.push(answer); listen({ data: message }); });

const { config, docs } = JSON.parse(readFileSync(index, "utf8"));
await ask({ type: 0, data: { config, docs, options: { suggest: false } } });
const found = {};
for (const query of JSON.parse(readFileSync(0, "utf8"))) {
  const { data } = await ask({ type: 2, data: query });
  found[query] = data.items.map((hits) => hits[0].location.split("#")[0]).filter(
    (page, place, all) => all.indexOf(page) === place);
}
console.log(JSON.stringify(found));
