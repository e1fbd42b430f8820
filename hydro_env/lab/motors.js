// Two shafts that turn, with speeds and commands in numbers. Between two messages each shaft goes on at its speed.
export default {
  template: `
  <div class="lab-motors">
    <svg v-for="(m, i) in motors" :key="i" viewBox="-110 -110 220 220" :class="'lab-motor-' + (i + 1)" role="img" :aria-label="'motor ' + (i + 1) + ' turns'">
      <circle r="104" class="lab-rim"/>
      <line v-for="k in 12" :key="k" x1="0" x2="0" y1="-98" :y2="k % 3 ? -90 : -82" class="lab-tick" :transform="'rotate(' + 30 * k + ')'"/>
      <g ref="hands"><path :d="i ? 'M-9 0V-76H9V0Z' : 'M-9 0V-66L0 -80L9 -66V0Z'" class="lab-hand"/><circle r="22" class="lab-hub"/></g>
      <text y="8">{{ i + 1 }}</text>
    </svg>
    <dl class="lab-numbers">
      <div class="lab-wide"><dt>difference, motor 1 less motor 2</dt><dd class="lab-big">{{ whole(difference) }} rpm</dd></div>
      <div class="lab-wide"><dt>set-point</dt><dd>{{ whole(setpoint) }} rpm</dd></div>
      <div v-for="(m, i) in motors" :key="i"><dt>motor {{ i + 1 }}</dt><dd>{{ whole(speed[i]) }} rpm</dd><dd>{{ command[i].toFixed(1).replace("-", "\u2212") }} V</dd></div>
    </dl>
  </div>`,
  data: () => ({ motors: [0, 1], speed: [0, 0], command: [0, 0], setpoint: 0, difference: 0 }),
  mounted() {
    this.angle = [0, 0]; this.rate = [0, 0]; this.at = performance.now();
    this.still = matchMedia("(prefers-reduced-motion: reduce)");
    const turn = now => {
      const ahead = Math.min((now - this.at) / 1000, 0.25);
      for (const i of [0, 1]) {
        // Who wants no motion sees by how much the shafts are apart.
        const angle = this.still.matches ? i * (this.angle[1] - this.angle[0]) : this.angle[i] + this.rate[i] * ahead;
        this.$refs.hands[i].setAttribute("transform", `rotate(${((angle * 180 / Math.PI) % 360).toFixed(1)})`);
      }
      this.frame = requestAnimationFrame(turn);
    };
    this.frame = requestAnimationFrame(turn);
  },
  unmounted() { cancelAnimationFrame(this.frame); },
  methods: {
    whole(value) { const n = Math.round(value); return (n === 0 ? 0 : n).toString().replace("-", "\u2212"); },
    // angle in rad; pace in rad for each rpm and second of the clock; the rest as it is shown.
    show(message) {
      this.angle = message.angle; this.at = performance.now();
      this.speed = [message.speed_1_rpm, message.speed_2_rpm]; this.command = [message.command_1_V, message.command_2_V];
      this.rate = this.speed.map(speed => message.pace * speed);
      this.setpoint = message.setpoint_rpm; this.difference = message.difference_rpm;
    },
  },
};
