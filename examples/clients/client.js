// Client of "smarttouch live socket:./touch". Run it by: node client.js ./touch
const line = require("net").connect(process.argv[2]);
const answers = require("readline").createInterface({ input: line })[Symbol.asyncIterator]();
async function ask(request, fields = {}) {
  line.write(JSON.stringify({ request, ...fields }) + "\n");
  return JSON.parse((await answers.next()).value);
}
(async () => {
  const { electrodes, most_level } = await ask("status");
  const one = (k) => Array.from({ length: electrodes }, (_, index) => Number(index === k % electrodes));
  await ask("level", { level: Math.min(0.6, most_level) });
  console.log(await ask("show", { pattern: one(27), seconds: 0.5 }));
  for (let k = 0; k < 30; k++) await ask("put", { pattern: one(k) });
  console.log(await ask("status"));
  console.log(await ask("stop"));
})();
