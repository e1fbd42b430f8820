// A labelled slider that keeps its own position, so that a late answer of the server never moves it under the hand.
export default {
  template: `
  <div class="lab-slider">
    <label :for="id"><span v-if="group" class="lab-quiet">{{ group }},&nbsp;</span>{{ label }}</label><output :for="id">{{ text }}</output>
    <input type="range" :id="id" :min="least" :max="most" :value="position" :aria-valuetext="text" @input="move">
  </div>`,
  props: { group: String, label: String, least: Number, most: Number, start: Number, text: String },
  data() { return { position: this.start, id: "slider-" + Math.random().toString(36).slice(2) }; },
  methods: {
    move(event) { this.position = Number(event.target.value); this.$emit("moved", this.position); },
    place(position) { this.position = position; },
  },
};
