// A person with a browser, against a real network (tests/interop/console.rs starts both):
//
//   node tests/browser.mjs OWNER_LINK MEMBER_LINK [DIRECTORY of screenshots]
//
// It says on standard output what it wants to happen next, one line each, and waits until its pages show it. It ends with 1 at the first
// thing that is not as it should be.
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import puppeteer from "puppeteer-core";

const [ownerLink, memberLink, shots] = process.argv.slice(2);
const axe = await readFile(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
// Less than the minute after which nobody waits for the next line.
const WAIT_MS = 45_000;
const DESK = { width: 1280, height: 900 };
const START_BYTES_MAX = 100_000;
// Blocks for which the lag is watched: more than those between two answers of the nodes.
const BLOCKS_DRIVEN = 150;
const PHONE = { width: 390, height: 844, isMobile: true, hasTouch: true };

const say = (line) => process.stdout.write(`${line}\n`);
const check = (holds, what) => {
  if (!holds) throw new Error(what);
};

const browser = await puppeteer.launch({
  executablePath: process.env.LEDGERD_TEST_CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"],
});

// A browser of its own: its own keys, its own sessions. Whatever it complains about fails the test.
async function person() {
  const context = await browser.createBrowserContext();
  const page = await context.newPage();
  await page.setViewport(DESK);
  page.complaints = [];
  page.tokens = [];
  page.on("pageerror", (error) => page.complaints.push(String(error)));
  page.on("console", (message) => {
    // The browser itself reports answers with an error code; those are looked at on the page.
    if (message.type() === "error" && !message.text().startsWith("Failed to load resource")) page.complaints.push(message.text());
  });
  page.on("request", (request) => {
    const told = request.headers().authorization;
    if (told) page.tokens.push(told);
    // A browser has pictures of its own, for fields of times.
    if (!request.url().startsWith(origin) && !request.url().startsWith("data:")) page.complaints.push(`asks elsewhere: ${request.url()}`);
  });
  return page;
}

const origin = new URL(ownerLink).origin;
const shows = (page, text) => page.waitForFunction((wanted) => document.body.innerText.includes(wanted), { timeout: WAIT_MS, polling: "mutation" }, text);
// Sets the place until it is there: a page that becomes one of a phone loads again, and goes back to the place of before.
const go = (page, place, title) => page.waitForFunction((hash, wanted) => {
  if (location.hash !== hash) location.hash = hash;
  return document.querySelector("h1")?.textContent === wanted;
}, { timeout: WAIT_MS }, place, title);

// Once it stands still: what comes from the node moves a page.
const click = (page, selector) => page.locator(selector).setTimeout(WAIT_MS).click();

async function press(page, name) {
  await click(page, `::-p-aria([name="${name}"][role="button"])`);
}

async function photograph(page, name) {
  if (shots) await page.screenshot({ path: `${shots}/${name}.png`, fullPage: true });
}

// Nothing serious for people who use a screen reader, a keyboard, or their own colours.
async function accessible(page, name) {
  await page.evaluate(axe);
  const found = await page.evaluate(async () => (await window.axe.run(document)).violations.map(({ id, impact, help, nodes }) => ({ id, impact, help, at: nodes.map((node) => `${node.html} ${node.any.map((each) => each.message).join("; ")}`).slice(0, 3) })));
  const serious = found.filter(({ impact }) => impact === "serious" || impact === "critical");
  check(serious.length === 0, `axe finds at ${name}: ${JSON.stringify(serious, null, 1)}`);
  say(`accessible ${name}: ${found.length} minor ${found.map(({ id }) => id).join()}`);
}

// The files that a visit loads, uncompressed, whether the browser has them already or not.
async function weighed(page, visit) {
  const seen = new Map();
  const count = (answer) => {
    const { pathname } = new URL(answer.url());
    if (answer.request().method() === "GET" && !pathname.startsWith("/v1/")) seen.set(pathname, answer);
  };
  page.on("response", count);
  await visit();
  page.off("response", count);
  let bytes = 0;
  for (const path of seen.keys()) bytes += (await (await fetch(origin + path)).arrayBuffer()).byteLength;
  return { bytes, files: seen.size };
}

const PLACES = [
  ["#/robots", "Robots", "robots"],
  ["#/tasks", "Tasks", "tasks"],
  ["#/access/Rover", "Access", "access"],
  ["#/robots/Rover", "Rover", "robot"],
  ["#/feed", "Feed", "feed"],
  ["#/blocks", "Blocks", "blocks"],
  ["#/policies/Org2", "Policies", "policies"],
  ["#/can/Rover%2Fcmd_vel", "Can somebody do something?", "can"],
  ["#/identities", "Identities", "identities"],
  ["#/nodes", "Nodes", "nodes"],
];

// The middle and the edges of a button, by its text.
async function placeOf(page, text) {
  const found = await page.waitForFunction((wanted) => {
    const button = [...document.querySelectorAll("button")].find((each) => each.textContent === wanted && each.getAttribute("aria-busy") !== "true");
    if (!button) return null;
    const { left, right, top, bottom } = button.getBoundingClientRect();
    return { left, right, top, bottom, disabled: button.disabled };
  }, { timeout: WAIT_MS }, text);
  return found.jsonValue();
}

const overlap = (one, other) => one.left < other.right && other.left < one.right && one.top < other.bottom && other.top < one.bottom;

// The text of what a click there would reach.
const at = (page, { left, right, top, bottom }) => page.evaluate((x, y) => document.elementFromPoint(x, y)?.textContent, (left + right) / 2, (top + bottom) / 2);

// A real double click, or two taps, wherever a button is and whatever comes in its place.
async function twice(page, { left, right, top, bottom }, isPhone) {
  const [x, y] = [(left + right) / 2, (top + bottom) / 2];
  if (!isPhone) return page.mouse.click(x, y, { count: 2 });
  await page.touchscreen.tap(x, y);
  await page.touchscreen.tap(x, y);
}

// Decisions about the robot, from the ledger.
const decisions = (page, decision) => page.evaluate(async (token, wanted) => {
  const answer = await fetch("/v1/audit?robot=Rover&limit=1000", { headers: { authorization: token } });
  return (await answer.json()).rows.filter((row) => row.decision === wanted).map((row) => row.detail);
}, page.tokens.at(-1), decision);

// Two clicks at one place stop, and resume nothing. What sets a robot in motion or takes it is asked for at another place, later, with
// a reason.
async function doubleClicks(page, size, viewport) {
  const isPhone = size === "phone";
  const why = `the cell is empty, at a ${size}`;
  await page.setViewport(viewport);
  await go(page, "#/robots/Rover", "Rover");
  await page.evaluate(() => scrollTo(0, 0));
  const before = (await decisions(page, "resumed")).length;
  const stop = await placeOf(page, "Stop");
  await twice(page, stop, isPhone);
  await page.waitForSelector(".mark.stopped", { timeout: WAIT_MS });
  const after = await placeOf(page, "Stop");
  check(after.left === stop.left && after.top === stop.top, `Stop is elsewhere: ${JSON.stringify([stop, after])}`);
  const resume = await placeOf(page, "Resume…");
  check(!overlap(resume, stop), "Resume is where Stop was");
  await twice(page, resume, isPhone);
  await page.waitForSelector('[role="dialog"]', { timeout: WAIT_MS });
  const confirm = await placeOf(page, "Resume");
  check(confirm.disabled, "without a reason it is not confirmed");
  check(!overlap(confirm, stop) && !overlap(confirm, resume), `the answer is where a button was: ${JSON.stringify([confirm, stop, resume])}`);
  check((await at(page, stop)) === "Stop", "Stop is not within reach");
  await accessible(page, `question, ${size}`);
  await photograph(page, `question-${size}`);
  await page.keyboard.press("Escape");
  await page.waitForFunction(() => !document.querySelector('[role="dialog"]'), { timeout: WAIT_MS });

  // A reason that is there at once does not help: the clock of the page stands still, and so the question cannot be answered.
  await page.evaluate(() => {
    window.now = Date.now;
    const at = Date.now();
    Date.now = () => at;
  });
  await page.click('::-p-aria([name="Resume…"][role="button"])');
  await page.waitForSelector('[role="dialog"]', { timeout: WAIT_MS });
  await page.type('[role="dialog"] input', why);
  await page.keyboard.press("Enter");
  check((await placeOf(page, "Resume")).disabled, "it is confirmed within the time of a double click");
  check((await decisions(page, "resumed")).length === before, "a double click has resumed the robot");
  await page.evaluate(() => void (Date.now = window.now));
  await page.waitForFunction(() => [...document.querySelectorAll("button")].some((button) => button.textContent === "Resume" && !button.disabled), { timeout: WAIT_MS });
  await press(page, "Resume");
  await page.waitForFunction(() => !document.querySelector(".mark.stopped") && !document.querySelector('[role="dialog"]'), { timeout: WAIT_MS });
  const resumed = await decisions(page, "resumed");
  check(resumed.length === before + 1 && resumed.some((detail) => detail.includes(why)), `resumed: ${JSON.stringify(resumed)}`);

  // Override: the same.
  const overridden = (await decisions(page, "overridden")).length + (await decisions(page, "granted")).length;
  const override = await placeOf(page, "Override…");
  await page.evaluate((y) => scrollTo(0, Math.max(0, y - innerHeight / 2)), override.top);
  await twice(page, await placeOf(page, "Override…"), isPhone);
  await page.waitForSelector('[role="dialog"]', { timeout: WAIT_MS });
  const take = await placeOf(page, "Override");
  check(take.disabled && !overlap(take, await placeOf(page, "Override…")), "Override is one click");
  await press(page, "Cancel");
  check((await decisions(page, "overridden")).length + (await decisions(page, "granted")).length === overridden, "a double click has taken the robot");
  say(`double clicks at a ${size}`);
}

// Nothing is cut, and nothing has to be scrolled sideways.
const cut = (page) => page.evaluate(() => {
  const isCut = (element) => {
    const { right, width } = element.getBoundingClientRect();
    const clips = getComputedStyle(element).overflowX !== "visible" && element.scrollWidth > element.clientWidth + 1;
    return width > 1 && (right > innerWidth + 1 || clips) && !element.closest("svg, .chart, .unseen, thead, pre, input, select");
  };
  return [...document.querySelectorAll("body *")].filter(isCut).map((element) => `${element.tagName} ${element.textContent.slice(0, 60)}`).slice(0, 5);
});

async function enrol(page, link, id) {
  await page.goto(link);
  await shows(page, id);
  await page.waitForFunction((secret) => !location.href.includes(secret), { timeout: 5000 }, link.split("/").pop());
  await press(page, "Enrol this browser");
  await shows(page, "Rover");
  await shows(page, "live");
}

async function story() {
  const [owner, member] = [await person(), await person()];

  // Without an identity nothing is shown.
  await owner.goto(`${origin}/`);
  await shows(owner, "ledgerctl console NAME");
  await accessible(owner, "stranger");
  await photograph(owner, "stranger");
  await enrol(owner, ownerLink, "Org2/Admin-browser");
  await enrol(member, memberLink, "Org1/Tablet");
  say("enrolled");

  // A link in a browser with an identity asks first, and the identity stays.
  await owner.goto(`${origin}/#/%`);
  await shows(owner, "Rover");
  await owner.goto("about:blank");
  await owner.goto(memberLink);
  await shows(owner, "This browser is Org2/Admin-browser now");
  await shows(owner, "Replace Org2/Admin-browser");
  await accessible(owner, "replacing");
  await press(owner, "Stay Org2/Admin-browser");
  await shows(owner, "Rover");

  // A key that is used up is no use to somebody else.
  const thief = await person();
  await thief.goto(memberLink);
  await press(thief, "Enrol this browser");
  await thief.waitForSelector('[role="alert"]', { timeout: WAIT_MS });
  check((await thief.$eval('[role="alert"]', (alert) => alert.innerText)).includes("LGR-2007"), "the second use of a secret is refused with its code");
  await thief.close();

  // The key cannot be read, not even by a script of the page.
  const kept = await owner.evaluate(
    () =>
      new Promise((resolve) => {
        indexedDB.open("ledgerd").onsuccess = ({ target }) => {
          target.result.transaction("identity").objectStore("identity").get("own").onsuccess = async ({ target: { result } }) =>
            resolve({ extractable: result.key.extractable, exported: await crypto.subtle.exportKey("pkcs8", result.key).then(() => true, () => false) });
        };
      }),
  );
  check(!kept.extractable && !kept.exported, `the key can be read: ${JSON.stringify(kept)}`);
  const stored = await owner.evaluate(() => JSON.stringify({ ...localStorage, ...sessionStorage }) + document.cookie);
  check(stored === "{}", `something is stored: ${stored}`);

  // A grant appears.
  await go(owner, "#/feed", "Feed");
  await owner.evaluate(() => {
    window.seen = new Promise((resolve) => {
      const look = () => {
        const row = [...document.querySelectorAll("tbody tr")].find((row) => row.innerText.includes("granted") && row.innerText.includes("Org1/Salma"));
        if (row) resolve(Date.now() - Date.parse(row.querySelector("time").dateTime));
      };
      new MutationObserver(look).observe(document.body, { childList: true, subtree: true, characterData: true });
    });
  });
  say("wants grant");
  say(`grant after ${(await owner.evaluate(() => window.seen)).toFixed(0)} ms`);
  await go(owner, "#/robots", "Robots");
  await shows(owner, "Org1/Salma");
  await photograph(owner, "robots");

  // The robot is driven: rate, latency, and the Twist in words.
  await go(owner, "#/robots/Rover", "Rover");
  say("wants driving");
  await shows(owner, "linear.x");
  await owner.waitForFunction(() => /p50 [\d.]+ ms/.test(document.body.innerText) && /Rate\s+[1-9]/.test(document.body.innerText) && document.querySelector("figure path.line")?.getAttribute("d"), { timeout: WAIT_MS });
  const before = await owner.$eval("figure path.line", (line) => line.getAttribute("d"));
  await owner.waitForFunction((old) => document.querySelector("figure path.line").getAttribute("d") !== old, { timeout: WAIT_MS }, before);
  // Messages have a sender.
  await owner.waitForFunction(() => [...document.querySelectorAll("td[data-name=Sender]")].some((cell) => cell.innerText === "Org1/Salma"), { timeout: WAIT_MS });
  await photograph(owner, "robot");
  say(await owner.$$eval("figcaption", (captions) => captions.map((caption) => caption.innerText).join(" · ")));

  // The only node of a network lags behind no other, while blocks come.
  await go(owner, "#/nodes", "Nodes");
  await owner.waitForSelector("td[data-name=Lag]", { timeout: WAIT_MS });
  const lags = await owner.evaluate((blocks) => new Promise((resolve) => {
    const lags = new Set();
    const height = () => Number(/block (\d+)/.exec(document.querySelector("header").innerText)?.[1]);
    const first = height();
    const observer = new MutationObserver(() => {
      lags.add(document.querySelector("td[data-name=Lag]").innerText);
      if (height() < first + blocks) return;
      observer.disconnect();
      resolve([...lags]);
    });
    observer.observe(document.body, { childList: true, subtree: true, characterData: true });
  }), BLOCKS_DRIVEN);
  check(lags.join() === "0", `the only node lags: ${lags}`);

  // A rejected request for the nodes shows its reason above the table.
  await owner.evaluate(() => {
    const fetched = window.fetch;
    window.fetch = (place, ...rest) => {
      if (!String(place).startsWith("/v1/nodes")) return fetched(place, ...rest);
      window.fetch = fetched;
      return Promise.resolve(new Response(JSON.stringify({ message: "the nodes are listed for admins only", code: "LGR-3010" }), { status: 403 }));
    };
  });
  await shows(owner, "the nodes are listed for admins only");
  await go(owner, "#/robots/Rover", "Rover");

  // A refused action shows its reason.
  await go(member, "#/robots/Rover", "Rover");
  await press(member, "Stop");
  const told = () => [...document.querySelectorAll('[role="alert"]')].map((alert) => alert.innerText).find((text) => text.includes("may not stop Rover"));
  const reason = await (await member.waitForFunction(told, { timeout: WAIT_MS })).jsonValue();
  check(/LGR-3\d+/.test(reason) && /try/i.test(reason), `a refusal without code or advice: ${reason}`);
  say(`refused: ${reason.replaceAll("\n", " ")}`);
  await accessible(member, "refusal");
  await photograph(member, "refused");

  // Stop, as the owner.
  await owner.type('input[placeholder="why, for the others"]', "a person on the floor");
  await press(owner, "Stop");
  await shows(owner, "a person on the floor");
  await owner.waitForSelector(".mark.stopped", { timeout: WAIT_MS });
  say("stopped");
  await shows(member, "a person on the floor");
  await photograph(owner, "stopped");

  // The proof of it.
  await click(owner, "tbody tr td:last-child a");
  await owner.waitForFunction(() => /^Block \d+$|^Transaction$/.test(document.querySelector("h1")?.textContent ?? ""), { timeout: WAIT_MS });
  await photograph(owner, "block");
  await accessible(owner, "block");
  if (!(await owner.evaluate(() => location.hash.startsWith("#/tx/")))) {
    await click(owner, 'td a[href^="#/tx/"]');
  }
  await owner.waitForFunction(() => document.querySelector("h1")?.textContent === "Transaction", { timeout: WAIT_MS });
  await press(owner, "Check the proof");
  await shows(owner, "The proof holds: signed by Org1/node1");
  await accessible(owner, "transaction");
  await photograph(owner, "transaction");

  // Blocks say which robot, person and action. Times are those of the browser's zone, with UTC behind them.
  await owner.emulateTimezone("Asia/Tokyo");
  await go(owner, "#/blocks", "Blocks");
  await owner.waitForFunction(() => [...document.querySelectorAll("td .happened li")].some((line) => /Org2\/Admin-browser stop Rover/.test(line.innerText)), { timeout: WAIT_MS });
  const time = await owner.$eval("td time", ({ dateTime, title, innerText }) => ({ at: Date.parse(dateTime), title, text: innerText }));
  const inTokyo = new Date(time.at + 9 * 3_600_000).toISOString().slice(11, 19);
  check(time.text.endsWith(inTokyo) && time.title.endsWith("UTC") && Date.parse(time.title.replace(" UTC", "Z")) === time.at, `a time: ${JSON.stringify(time)}`);
  await owner.emulateTimezone("Etc/UTC");

  // Search by robot.
  await go(owner, "#/blocks", "Blocks");
  await owner.type('input[type="search"]', "Rover");
  await owner.keyboard.press("Enter");
  await shows(owner, "decisions about Rover");
  await photograph(owner, "search");

  // Can somebody do something, and why not?
  await go(member, "#/can/Rover%2Fcmd_vel", "Can somebody do something?");
  await press(member, "Ask");
  await shows(member, "may not acquire Rover/cmd_vel");
  await photograph(member, "can");

  await go(owner, "#/robots/Rover", "Rover");
  await press(owner, "Resume…");
  await owner.waitForSelector('[role="dialog"]', { timeout: WAIT_MS });
  await owner.type('[role="dialog"] input', "the floor is clear");
  await press(owner, "Resume");
  await owner.waitForFunction(() => !document.querySelector(".mark.stopped"), { timeout: WAIT_MS });
  say("resumed");
  await doubleClicks(owner, "desk", DESK);
  await doubleClicks(owner, "phone", PHONE);
  await owner.setViewport(DESK);

  // Access: who may do what. The owner shares the robot with a person by the form, and ends that.
  await go(owner, "#/access/Rover", "Access");
  await shows(owner, "as an admin of the owner");
  await owner.waitForFunction(() => [...document.querySelectorAll("tr")].some((row) => /Org1\/Salma/.test(row.innerText) && /acquire/.test(row.innerText)), { timeout: WAIT_MS });
  await owner.type('input[name="with"]', "Org1/Tablet");
  await click(owner, 'input[name="read_only"]');
  await press(owner, "Preview");
  await shows(owner, "Org1/Tablet: subscribe Rover/cmd_vel");
  await accessible(owner, "preview of a share");
  await photograph(owner, "share");
  await press(owner, "Share");
  const share = await (await owner.waitForFunction(() => document.querySelector('td[data-name="Share"]')?.innerText, { timeout: WAIT_MS })).jsonValue();
  await go(member, "#/access/Rover", "Access");
  await shows(member, `by ${share}`);
  check((await member.$('input[name="with"]')) === null, "a member of another organisation is offered to share");
  await press(owner, `End… ${share}`);
  await shows(owner, "Who may no longer");
  await photograph(owner, "unshare");
  await press(owner, "End sharing");
  await shows(owner, "is shared by no share");
  say("shared");

  // Tasks, with those who wait.
  await go(owner, "#/tasks", "Tasks");
  say("wants task");
  await owner.waitForFunction(() => /scheduled/.test(document.body.innerText) && /Org1\/Salma/.test(document.body.innerText) && /0 of 2/.test(document.body.innerText), { timeout: WAIT_MS });
  check((await owner.$eval("progress", ({ value, max, position }) => [value, max, position].join())) === "0,2,0", "a task that has not begun shows progress");

  // A policy that applies to no one of today.
  await go(owner, "#/policies/Org2", "Policies");
  say("wants policy");
  await shows(owner, "weekend applies to no one today");
  await shows(owner, "Org1/Mallory, which does not exist");

  // Stop is one click in the list of robots, too.
  await go(owner, "#/robots", "Robots");
  await press(owner, "Stop Rover");
  await owner.waitForSelector(".map .mark.stopped", { timeout: WAIT_MS });


  // Every page, for everybody: by day and by night, at a desk and in a hand.
  for (const scheme of ["light", "dark"]) {
    await owner.emulateMediaFeatures([{ name: "prefers-color-scheme", value: scheme }]);
    for (const [size, viewport] of [["desk", DESK], ["phone", PHONE]]) {
      await owner.setViewport(viewport);
      for (const [place, title, name] of PLACES) {
        await go(owner, place, title);
        await owner.waitForNetworkIdle({ idleTime: 150, concurrency: 3, timeout: 5000 }).catch(() => undefined);
        const wide = await owner.evaluate(() => document.documentElement.scrollWidth - document.documentElement.clientWidth);
        check(wide <= 0, `${name} is ${wide} pixels too wide on a ${size}`);
        const lost = await cut(owner);
        check(lost.length === 0, `${name} is cut on a ${size}: ${JSON.stringify(lost)}`);
        if (size === "desk" || scheme === "light") await accessible(owner, `${name}, ${scheme}, ${size}`);
        await photograph(owner, `${name}-${scheme}-${size}`);
      }
    }
  }
  await owner.setViewport(DESK);

  // The keyboard alone: the first stop leads to the content, the next ones to the places.
  await go(owner, "#/robots", "Robots");
  await owner.evaluate(() => document.activeElement.blur());
  // The start page of somebody who is known here: its files, as they stand.
  const start = await weighed(owner, async () => {
    await owner.reload();
    await shows(owner, "Rover");
  });
  say(`start page: ${start.bytes} bytes in ${start.files} files`);
  check(start.bytes < START_BYTES_MAX, `the start page has ${start.bytes} bytes, wanted less than ${START_BYTES_MAX}`);
  await owner.evaluate(() => document.activeElement?.blur());
  const stops = [];
  for (let stop = 0; stop < 5; stop += 1) {
    await owner.keyboard.press("Tab");
    stops.push(await owner.evaluate(() => document.activeElement.textContent.trim()));
  }
  check(stops.some((text) => ["Feed", "Blocks", "Rover", "Robots"].includes(text)), `the keyboard reaches ${stops}`);

  // A session that has ended asks again; nothing goes on without it.
  const token = owner.tokens.at(-1);
  const ended = await owner.evaluate((told) => fetch("/session/end", { method: "POST", headers: { authorization: told } }).then((answer) => answer.status), token);
  check(ended === 204, `the session does not end: ${ended}`);
  await shows(owner, "The session has ended");
  await accessible(owner, "ended");
  await photograph(owner, "ended");
  await press(owner, "Continue as Org2/Admin-browser");
  await owner.waitForSelector(".map", { timeout: WAIT_MS });
  check(owner.tokens.at(-1) !== token || (await shows(owner, "live")), "it has another session");
  say("asked again");

  for (const page of [owner, member]) check(page.complaints.length === 0, `the browser complains: ${page.complaints.join("\n")}`);
}

let code = 0;
try {
  await story();
  say("done");
} catch (error) {
  code = 1;
  say(`failed: ${error.stack ?? error}`);
  for (const [at, page] of (await browser.pages()).entries()) {
    say(`page ${at}: ${(await page.evaluate(() => document.body.innerText).catch(String)).replaceAll("\n", " | ").slice(0, 1500)} ${JSON.stringify(page.complaints ?? [])}`);
    if (shots) await page.screenshot({ path: `${shots}/failed-${at}.png` }).catch(() => undefined);
  }
}
await browser.close();
process.exit(code);
