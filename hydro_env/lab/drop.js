// A field for files: dropped, or chosen with the keyboard. Each file is sent as it is; the server bounds and names it.
export default {
  template: `
  <div class="lab-drop" :class="{ over }" @dragover.prevent="over = true" @dragleave="over = false" @drop.prevent="drop">
    <label :for="id">{{ label }}</label>
    <input type="file" :id="id" multiple :accept="accept" @change="choose">
    <span aria-live="polite">{{ doing }}</span>
  </div>`,
  props: { label: String, accept: String, most: Number },
  data: () => ({ over: false, doing: "", id: "files-" + Math.random().toString(36).slice(2) }),
  methods: {
    choose(event) { this.send([...event.target.files]); event.target.value = ""; },
    drop(event) { this.over = false; this.send([...event.dataTransfer.files]); },
    async send(files) {
      for (const file of files) {
        this.doing = `sending ${file.name} ...`;
        if (file.size > this.most) {
          this.$emit("refused", `${file.name}: larger than ${this.most / 2 ** 20} MiB; export a shorter part`);
          continue;
        }
        try {
          const answer = await fetch("/upload?name=" + encodeURIComponent(file.name), { method: "POST", body: file });
          if (!answer.ok) this.$emit("refused", (await answer.text()).trim());
        } catch (problem) {
          this.$emit("refused", `${file.name}: could not be sent`);
        }
      }
      this.doing = "";
      this.$emit("sent");
    },
  },
};
