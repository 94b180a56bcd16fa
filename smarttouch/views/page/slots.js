// Slots of a scan, shown all at once, as a slow sequence, or one by one with buttons.

import { calm } from "./views.js";

export class SlotPlayer {
  constructor(find) {
    this.find = find;
    this.slot = null;
    this.waiting = null;
    this.find("whole").addEventListener("click", () => this.go(null));
    this.find("slow").addEventListener("click", () => this.play());
    this.find("slot-before").addEventListener("click", () => this.step(-1));
    this.find("slot-after").addEventListener("click", () => this.step(1));
    this.find("speed").addEventListener("change", () => this.playing && this.play());
  }

  get playing() {
    return this.timer !== undefined;
  }

  // A whole scan is drawn at once. If slots are drawn one by one, a new scan waits for the last.
  take(picture) {
    if (this.slot === null || !this.view.picture) {
      this.view.take(picture);
      this.draw();
    } else {
      this.waiting = picture;
      if (!this.view.slots) this.next();
    }
  }

  draw() {
    if (!this.view.picture) return;
    if (this.slot !== null) this.slot = Math.max(0, Math.min(this.slot, this.view.slots - 1));
    const empty = this.slot !== null && !this.view.slots;
    this.view.show(empty ? null : this.slot);
    const words = this.slot === null ? "all slots" : `slot ${this.view.slots ? this.slot + 1 : 0} of ${this.view.slots}`;
    if (this.find("slot").textContent !== words) this.find("slot").textContent = words;
  }

  go(slot) {
    clearInterval(this.timer);
    this.timer = undefined;
    this.slot = slot;
    if (slot === null || !this.view.slots) this.newest();
    this.pressed();
    this.draw();
  }

  newest() {
    if (this.waiting) this.view.take(this.waiting);
    this.waiting = null;
  }

  step(by) {
    this.go(this.slot === null ? 0 : this.slot + by);
  }

  play() {
    if (calm()) {
      this.step(1);
      return;
    }
    clearInterval(this.timer);
    this.slot ??= 0;
    this.timer = setInterval(() => this.next(), 1000 / Number(this.find("speed").value));
    this.pressed();
    this.draw();
  }

  next() {
    if (!this.playing) return;
    this.slot += 1;
    if (this.slot >= this.view.slots) {
      this.newest();
      this.slot = 0;
    }
    this.draw();
  }

  pressed() {
    this.find("whole").setAttribute("aria-pressed", String(this.slot === null));
    this.find("slow").setAttribute("aria-pressed", String(this.playing));
  }
}
