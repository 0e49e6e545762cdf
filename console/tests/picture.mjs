// Takes the screenshot of the console for README.md; docs/pictures/draw.py starts the network and the driver, and calls this:
//
//   node console/tests/picture.mjs LINK ROBOT FILE.png
//
// It enrols a browser with the link, opens the page of the robot, and waits until messages have a rate and a latency.
import puppeteer from "puppeteer-core";

const [link, robot, file] = process.argv.slice(2);
const WAIT_MS = 45_000;

const browser = await puppeteer.launch({
  executablePath: process.env.LEDGERD_TEST_CHROMIUM ?? "/usr/bin/chromium",
  args: ["--no-sandbox", "--disable-dev-shm-usage", "--disable-gpu"],
});
try {
  const page = await browser.newPage();
  await page.setViewport({ width: 1200, height: 860 });
  await page.emulateMediaFeatures([{ name: "prefers-color-scheme", value: "light" }]);
  await page.emulateTimezone("Etc/UTC");
  await page.goto(link);
  await page.locator('::-p-aria([name="Enrol this browser"][role="button"])').setTimeout(WAIT_MS).click();
  await page.waitForFunction(() => document.body.innerText.includes("live"), { timeout: WAIT_MS });
  await page.evaluate((name) => void (location.hash = `#/robots/${name}`), robot);
  // A minute of messages: the span of the charts.
  await page.waitForFunction(() => /p50 [\d.]+ ms/.test(document.body.innerText) && document.querySelector("table caption, table"), { timeout: WAIT_MS });
  await new Promise((resolve) => setTimeout(resolve, 60_000));
  await page.screenshot({ path: file });
} finally {
  await browser.close();
}
