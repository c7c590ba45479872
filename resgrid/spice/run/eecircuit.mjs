// Finds the operating point of a deck with the npm package eecircuit-engine (ngspice as WebAssembly, with KLU).
// node eecircuit.mjs MODULE DECK RAW: imports MODULE, simulates DECK, writes the binary raw file RAW.
// Standard output holds the simulator's own messages.

import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";

const [module, deck, raw] = process.argv.slice(2);
const { Simulation } = await import(pathToFileURL(module).href);
const simulation = new Simulation();
await simulation.start();
simulation.setNetList(readFileSync(deck, "utf8"));
let result = null;
try {
  result = await simulation.runSim();
} catch (error) {
  console.log(`Error: ${error}`);
}
console.log(simulation.getInfo());
for (const line of simulation.getError()) console.log(line);
if (result === null || result.dataType !== "real") process.exit(1);

const header = (result.header.match(/^(?:Title|Date|Command|Plotname):.*$/gm) ?? []).join("\n");
console.log(header);
const variables = result.data.map(({ name, type }, i) => `\t${i}\t${name}\t${type}`).join("\n");
const points = result.data[0].values.length;
const counts = `Flags: real\nNo. Variables: ${result.data.length}\nNo. Points: ${points}\nVariables:\n`;
const values = new DataView(new ArrayBuffer(8 * points * result.data.length));
result.data.forEach(({ values: column }, i) =>
  column.forEach((value, k) => values.setFloat64(8 * (k * result.data.length + i), value, true)),
);
writeFileSync(raw, Buffer.concat([
  Buffer.from(`${header}\n${counts}${variables}\nBinary:\n`, "utf8"), Buffer.from(values.buffer),
]));
process.exit(0);
